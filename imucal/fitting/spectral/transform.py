"""Blocks -> Ordinates: sums of squares in bins, and of products with the regressors.

A regressor is a slow, known shape, such as a warm-up or the temperature, that is taken out with the
fit: a column of generalised least squares beside the ramp, so that what it takes out is judged
against the noise at the same frequencies.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.spectral.blocks import Block
from imucal.fitting.spectral.ordinates import LAWS, Ordinates
from imucal.fitting.spectral.scoring import maximize
from imucal.fitting.spectral.starts import find_starts
from imucal.fitting.spectral.structures import candidates_of

#: Square of the relative rounding error of a transform.
_ROUNDING = 1e-28
#: Shortest correlation time beside a regressor, in samples.
_SHORTEST = 2.0
#: Ordinates that such slow shapes live in.
_LOWEST = 4000
#: Time constants of a warm-up, as parts of the record.
_PARTS = np.geomspace(0.01, 0.3, 8)
#: What a shape must gain beyond the price of its parameters, in twice the log-likelihood.
_MARGIN = 10.0
_STRUCTURE = ("N", "B", "GM", "K", "R")


def bin_blocks(blocks: Sequence[Block], scale: float, names: tuple[str, ...] = ("R",)) -> Ordinates:
    """Return the binned ordinates of all blocks; the regressors `names` are common to them."""
    parts = [_bin(block, names) for block in blocks]
    joined: dict[str, Any] = {key: np.concatenate([part[key] for part in parts], axis=-1) for key in parts[0]}
    return Ordinates(scale=scale, names=names, **joined)


def _bin(block: Block, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the arrays of one block's `Ordinates`, by their names."""
    bins, kept = block.bins, block.kept

    def total(values: FloatArray) -> FloatArray:
        used = values if kept is None else np.where(kept, values, 0.0)
        summed: FloatArray = np.add.reduceat(used, bins.first - 1)
        return summed

    count = bins.count.astype(np.float64)
    size = count if kept is None else np.add.reduceat(kept.astype(np.float64), bins.first - 1)
    square = block.ordinates**2
    # The transform's own rounding: no bin of exactly no power, not even of a straight line.
    square += _ROUNDING * float(square.mean())
    power = total(square if block.variance is None else square + block.variance)
    vectors = [block.regressor(name) for name in names]
    cross = np.array([total(block.ordinates * v) for v in vectors]).reshape(len(names), bins.size)
    gram = np.zeros((len(names), len(names), bins.size))
    for i, v in enumerate(vectors):
        for j, w in enumerate(vectors[: i + 1]):
            gram[i, j] = gram[j, i] = total(v * w)
    if block.loss is not None:
        keep = 1 - block.loss
        size, power, cross, gram = size * keep, power * keep, cross * keep, gram * keep
    return {
        "size": size,
        "power": power,
        "lam": LAWS[0].psd(bins.omega),
        "length": np.full(bins.size, float(bins.n)),
        "sign": np.where(bins.count == 1, np.where(bins.first % 2 == 0, 1.0, -1.0), 0.0),
        "basis": np.array([law.dct_spectrum(bins.n, bins.first, bins.count) for law in LAWS]),
        "cross": cross,
        "gram": gram,
    }


def choose_regressors(
    blocks: Sequence[Block], *, axis: str, tau0: float
) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Return names of the regressors beside the ramp that the data ask for, and say so."""
    low = [block.lowest(max(_LOWEST // len(blocks), 64)) for block in blocks]
    length = blocks[-1].offset + blocks[-1].bins.n
    exponentials = [f"exp:{part * length!r}" for part in _PARTS.tolist()]
    names = ("R", *exponentials)
    if all(block.temperature is not None and np.any(block.temperature) for block in blocks):
        names += ("temperature",)
    ordinates = bin_blocks(low, 1.0, names)
    ordinates = ordinates.take(ordinates.size > 0)
    chosen: tuple[str, ...] = ()
    findings: list[Finding] = []
    if "temperature" in names:
        alone, heated = _objectives(ordinates, [(), ("temperature",)])
        if 2 * (alone - heated) > np.log(length) + _MARGIN:
            chosen = ("temperature",)
            findings.append(_temperature_finding(axis))
    alone, *warm = _objectives(ordinates, [chosen, *((*chosen, name) for name in exponentials)])
    best = int(np.argmin(warm))
    if 2 * (alone - warm[best]) > 2 * np.log(length) + _MARGIN:
        chosen += (exponentials[best],)
        findings.append(_warm_up_finding(axis, float(_PARTS[best]) * length * tau0))
    return chosen, tuple(findings)


def _objectives(ordinates: Ordinates, sets: list[tuple[str, ...]]) -> list[float]:
    """Return the least -log L of a rich structure with each set of regressors beside the ramp."""
    shown = [(*_STRUCTURE, *names) for names in sets]
    candidates = candidates_of(shown, ordinates.names)
    owner, theta = find_starts(ordinates, candidates, shortest=_SHORTEST, keep=(1, 2, 2))
    found = maximize(
        ordinates, candidates.take(owner), theta, shortest=_SHORTEST, tolerance=1e-2, iterations=40
    )
    best = np.full(len(sets), np.inf)
    np.minimum.at(best, owner, found.objective)
    return best.tolist()


def _temperature_finding(axis: str) -> Finding:
    return Finding(
        level="info",
        code="temperature",
        axis=axis,
        text="The axis follows the temperature; a linear effect is taken out with the fit.",
        advice="Use the noise model together with a temperature compensation.",
    )


def _warm_up_finding(axis: str, seconds: float) -> Finding:
    return Finding(
        level="warning",
        code="warm-up-fitted",
        axis=axis,
        text=f"The axis settles exponentially, with a time constant of {seconds:.3g} s; this drift is taken "
        "out with the fit.",
        advice="Leave out the first part of the record, or let the sensor warm up before recording.",
    )

"""Which slow, known shapes are taken out with the fit: warm-up and temperature.

Each is a column of generalised least squares beside the ramp, so that what it takes out is judged
against the noise at the same frequencies.
"""

from collections.abc import Sequence

import numpy as np

from imucal.findings import Finding
from imucal.fit.blocks import Block
from imucal.fit.ordinates import Ordinates
from imucal.fit.scoring import maximize
from imucal.fit.starts import find_starts
from imucal.fit.structures import candidates_of
from imucal.fit.transform import bin_blocks

__all__ = ["choose_regressors"]

#: Ordinates that such slow shapes live in.
_LOWEST = 4000
#: Time constants of a warm-up, as parts of the record.
_PARTS = np.geomspace(0.01, 0.3, 8)
#: What a shape must gain beyond the price of its parameters, in twice the log-likelihood.
_MARGIN = 10.0
_STRUCTURE = ("N", "B", "GM", "K", "R")


def choose_regressors(
    blocks: Sequence[Block], *, axis: str, tau0: float
) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Return names of the regressors beside the ramp that the data ask for, and say so."""
    low = [block.lowest(max(_LOWEST // len(blocks), 64)) for block in blocks]
    length = blocks[-1].offset + blocks[-1].bins.n
    chosen: tuple[str, ...] = ()
    findings: list[Finding] = []
    if all(block.temperature is not None and np.any(block.temperature) for block in blocks):
        gain = _gain(low, (), ["temperature"])[0]
        if gain > np.log(length) + _MARGIN:
            chosen += ("temperature",)
            findings.append(_temperature_finding(axis))
    names = [f"exp:{part * length!r}" for part in _PARTS.tolist()]
    gains = _gain(low, chosen, names)
    best = int(np.argmax(gains))
    if gains[best] > 2 * np.log(length) + _MARGIN:
        chosen += (names[best],)
        findings.append(_warm_up_finding(axis, float(_PARTS[best]) * length * tau0))
    return chosen, tuple(findings)


def _gain(low: list[Block], chosen: tuple[str, ...], names: list[str]) -> list[float]:
    """Return twice the log-likelihood that each regressor gains beside those chosen."""
    base = _objective(bin_blocks(low, 1.0, ("R", *chosen)), chosen)
    return [
        2 * (base - _objective(bin_blocks(low, 1.0, ("R", *chosen, name)), (*chosen, name))) for name in names
    ]


def _objective(ordinates: Ordinates, common: tuple[str, ...]) -> float:
    seen = ordinates.take(ordinates.size > 0)
    candidates = candidates_of([_STRUCTURE], seen.names, common=common)
    starts = find_starts(seen, candidates, keep=(1, 2, 2))
    rows = np.zeros(starts.candidate.size, dtype=np.int64)
    found = maximize(seen, candidates.take(rows), starts.theta, tolerance=1e-2, iterations=40)
    return float(found.objective.min())


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

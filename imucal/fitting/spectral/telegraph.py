"""Random telegraph noise: a level that jumps to and fro between two values.

Its spectrum is that of a Gauss-Markov process, so no spectrum tells them apart; their distributions
do. Means over short spans are explained twice: by two levels with a chance of jumping between them and
white noise (a hidden Markov model), and by the richest Gaussian noise. The likelihoods decide.

Source: Rabiner (1989), Proc. IEEE 77, 257 (the likelihood of a hidden Markov model); Machlup (1954),
J. Appl. Phys. 25, 341 (the spectrum).
"""

from dataclasses import dataclass

import numpy as np

from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.spectral.blocks import Block
from imucal.fitting.spectral.scoring import maximize
from imucal.fitting.spectral.starts import find_starts
from imucal.fitting.spectral.structures import candidates_of
from imucal.fitting.spectral.transform import bin_blocks
from imucal.recording import AxisSeries
from imucal.solvers import lowest
from imucal.units import pretty

#: Spans, and fewest samples of one; a span is short against the time between jumps that can be told.
_SPANS, _FEWEST = 1024, 8
#: Parts of the record whose levels have a mean of their own, since slow noise moves both; and how much better
#: in log-likelihood, beyond the price of their means, two levels must then explain the means.
_PARTS = {1: 18.0, 4: 10.0}
#: Chance of a span that holds a jump, or is no part of either level.
_BETWEEN = 0.05
#: Quantiles and mean spans between jumps from which the levels are searched.
_QUANTILES = (0.1, 0.2, 0.3)
_DWELLS = (4.0, 20.0, 100.0)
#: Log-likelihood that noise which is not white must gain on white noise, so that jumps are worth a look.
_COLOURED = 15.0
#: Half the distance of two levels that are two, in deviations of a span's noise.
_APART = 0.25
#: Fewer jumps a record are steps, each of its own.
_JUMPS = 8
#: A start that is worse than the Gaussian noise by this much a span leads nowhere.
_HOPELESS = 0.012
_RICH = ("N", "B", "GM", "K", "R")
#: Means that differ by less than this part of the samples are equal; and the least noise of means that start
#: a search, over their deviation: those of a level without noise have none.
_ROUNDING, _QUIETEST = 1e-12, 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoLevels:
    """A level that jumps: half the distance of the levels, in U, and the mean time between jumps, in s."""

    amplitude: float
    dwell_s: float


def find_telegraph(series: AxisSeries) -> TwoLevels | None:
    """Return the two levels of finite samples; None where Gaussian noise explains them as well.

    Samples are taken as if there were no gaps.
    """
    width = max(series.n // _SPANS, _FEWEST)
    count = min(series.n // width, _SPANS)
    if count < _SPANS // 4:
        return None
    means = np.add.reduceat(series.samples[: count * width], np.arange(0, count * width, width)) / width
    scale = float(means.std())
    if scale <= _ROUNDING * float(np.abs(series.samples).max()):
        return None
    means = (means - means.mean()) / scale
    white, rich = _gaussian(means)
    if white - rich < _COLOURED:
        return None
    best, found = 0.0, None
    for parts, margin in _PARTS.items():
        price = 0.5 * (parts - 1) * np.log(count)
        divided = means[: count - count % parts].reshape(parts, -1)
        gain, parameters = _two_levels(divided, rich)
        if gain - price - margin > best and _jumps_often(parameters, divided):
            best, found = gain - price - margin, parameters
    if found is None:
        return None
    half, _, dwell = np.exp(found[:3]).tolist()
    return TwoLevels(amplitude=scale * half, dwell_s=width * series.tau0 * dwell)


def telegraph_finding(found: TwoLevels | None, series: AxisSeries) -> tuple[Finding, ...]:
    """Return what to say of two levels."""
    if found is None:
        return ()
    return (
        Finding(
            level="warning",
            code="telegraph",
            axis=series.name,
            text="The level jumps to and fro between two values, "
            f"±{found.amplitude:.3g} {pretty(series.unit)}, every {found.dwell_s:.3g} s on average: "
            "random telegraph noise.",
            advice="The fit takes it for B or GM: its spectrum is right, but no Gaussian noise jumps.",
        ),
    )


def _gaussian(means: FloatArray) -> tuple[float, float]:
    """Return -log L of means of unit variance as white, and as the richest, Gaussian noise."""
    n = means.size
    ordinates = dct_ordinates(means)
    seen = bin_blocks([Block(offset=0, bins=dct_bins(n), ordinates=ordinates)], 1.0)
    candidates = candidates_of([("N",), _RICH], seen.names)
    owner, theta = find_starts(seen, candidates, shortest=2.0, keep=(1, 2, 2))
    found = maximize(seen, candidates.take(owner), theta, shortest=2.0, tolerance=1e-2, iterations=60)
    costs = [float(found.objective[owner == index].min()) for index in range(2)]
    # The mean is ordinate 0, which the two levels explain and this does not: as white noise.
    constant = 0.5 * n * np.log(2 * np.pi)
    return costs[0] + constant, costs[1] + constant


def _two_levels(means: FloatArray, rich: float) -> tuple[float, FloatArray]:
    """Return how much better than -log L `rich` two levels explain means, and their parameters.

    `means`, shape (p, n/p), in parts; parameters: the logarithms of half the levels' distance, of the
    noise and of the mean spans between jumps; then the mean of the levels in each part.
    """
    between = np.median(np.diff(means, axis=1) ** 2) / (2 * 0.4549)
    noise = 0.5 * np.log(max(between, _QUIETEST**2))
    starts = []
    for q in _QUANTILES:
        low, high = np.quantile(means, [q, 1 - q], axis=1)
        half = np.log(max(np.mean(high - low) / 2, _QUIETEST))
        starts += [np.array([half, noise, np.log(dwell), *(low + high) / 2]) for dwell in _DWELLS]
    costs = [_cost(start, means) for start in starts]
    best = int(np.argmin(costs))
    if costs[best] - rich > _HOPELESS * means.size:
        return rich - costs[best], starts[best]
    found, cost = lowest(lambda at: _cost(at, means), starts[best], near=1e-2, alike=0.05, most=400)
    return rich - cost, found


def _jumps_often(parameters: FloatArray, means: FloatArray) -> bool:
    """Whether there are two levels at all, and fewer jumps, as single steps make, are less likely."""
    half, noise, _ = np.exp(parameters[:3]).tolist()
    if half < _APART * noise:
        return False
    seldom = parameters.copy()
    seldom[2] = np.log(means.size / _JUMPS)
    return bool(parameters[2] < seldom[2] and _cost(parameters, means) < _cost(seldom, means))


def _cost(parameters: FloatArray, means: FloatArray) -> float:
    """Return -log L of two levels; see `_two_levels`."""
    half, noise, dwell = np.exp(parameters[:3]).tolist()
    jump = 1 / (1 + dwell)
    z = ((means - parameters[3:, None])[:, :, None] - np.array([-half, half])) / noise
    density = (1 - _BETWEEN) / (np.sqrt(2 * np.pi) * noise) * np.exp(-0.5 * z * z)
    density += _BETWEEN / (2 * half + 6 * noise)
    stay = np.array([[1 - jump, jump], [jump, 1 - jump]])
    return -float(_log_product(density[:, :, None, :] * stay).sum())


def _log_product(matrices: FloatArray) -> FloatArray:
    """Return log of (1/2, 1/2) M_1 … M_n (1, 1)', shape (p,), of matrices of shape (p, n, 2, 2), in pairs."""
    total = np.zeros(len(matrices))
    while matrices.shape[1] > 1:
        size = matrices.max(axis=(2, 3), keepdims=True)
        total += np.log(size[:, :, 0, 0]).sum(axis=1)
        matrices = matrices / size
        if matrices.shape[1] % 2:
            last = np.broadcast_to(np.eye(2), (len(matrices), 1, 2, 2))
            matrices = np.concatenate([matrices, last], axis=1)
        matrices = np.einsum("pnij,pnjk->pnik", matrices[:, ::2], matrices[:, 1::2])
    return np.asarray(total + np.log(0.5 * matrices[:, 0].sum(axis=(1, 2))))

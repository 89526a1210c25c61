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
from imucal.units import pretty

#: Spans, and fewest samples of one; a span is short against the time between jumps that can be told.
_SPANS, _FEWEST = 2048, 8
#: Parts of the record with levels of their own: slow noise moves both.
_PARTS = (1, 4)
#: Chance of a span that holds a jump, or is no part of either level.
_BETWEEN = 0.05
#: Quantiles and mean spans between jumps from which the levels are searched.
_QUANTILES = (0.1, 0.2, 0.3)
_DWELLS = (6.0, 25.0, 100.0)
#: Log-likelihood by which two levels must explain the means better, beyond the price of their parameters.
_MARGIN = 15.0
#: A start that is worse than the Gaussian noise by this much a span leads nowhere.
_HOPELESS = 0.1
_RICH = ("N", "B", "GM", "K", "R")


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
    count = series.n // width
    if count < _SPANS // 8:
        return None
    means = series.samples[: count * width].reshape(count, width).mean(axis=1)
    means = (means - means.mean()) / means.std()
    white, rich = _gaussian(means)
    if white - rich < _MARGIN:
        return None
    price = 0.5 * np.log(count)
    best: tuple[float, TwoLevels] | None = None
    for parts in _PARTS:
        pieces = np.array_split(means, parts)
        fits = [_two_levels(piece, rich / parts) for piece in pieces]
        if any(fit is None for fit in fits):
            continue
        found = [fit for fit in fits if fit is not None]
        gain = rich - sum(fit.cost for fit in found) - price * (5 * parts - 5)
        if gain > _MARGIN and (best is None or gain > best[0]):
            scale = float(series.samples[: count * width].reshape(count, width).mean(axis=1).std())
            best = gain, TwoLevels(
                amplitude=scale * float(np.median([fit.half for fit in found])),
                dwell_s=width * series.tau0 * float(np.median([fit.dwell for fit in found])),
            )
    return best[1] if best else None


def telegraph_finding(found: TwoLevels | None, series: AxisSeries) -> tuple[Finding, ...]:
    """Return what to say of two levels."""
    if found is None:
        return ()
    return (
        Finding(
            level="warning",
            code="telegraph",
            axis=series.name,
            text=f"The level jumps to and fro between two values, ±{found.amplitude:.3g} {pretty(series.unit)}, "
            f"every {found.dwell_s:.3g} s on average: random telegraph noise.",
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Levels:
    """A hidden Markov model of two levels: -log L, half their distance, mean spans between jumps."""

    cost: float
    half: float
    dwell: float


def _two_levels(means: FloatArray, rich: float) -> _Levels | None:
    """Return the best two levels for some means; None where they are hopeless beside -log L `rich`."""
    from scipy.optimize import minimize

    noise = float(np.sqrt(np.median(np.diff(means) ** 2) / (2 * 0.4549)))
    starts = [
        np.array([np.quantile(means, q), np.quantile(means, 1 - q), np.log(noise), np.log(dwell)])
        for q in _QUANTILES
        for dwell in _DWELLS
    ]
    costs = [_cost(start, means) for start in starts]
    best = int(np.argmin(costs))
    if costs[best] - rich > _HOPELESS * means.size:
        return None
    found = minimize(
        _cost,
        starts[best],
        args=(means,),
        method="Nelder-Mead",
        options={"xatol": 1e-2, "fatol": 0.05, "maxfev": 250},
    )
    low, high, _, log_dwell = found.x.tolist()
    return _Levels(cost=float(found.fun), half=abs(high - low) / 2, dwell=float(np.exp(log_dwell)))


def _cost(parameters: FloatArray, means: FloatArray) -> float:
    """Return -log L of two levels; parameters: the levels, log of the noise, log of the mean spans between."""
    low, high, log_noise, log_dwell = parameters.tolist()
    noise, jump = np.exp(log_noise), 1 / (1 + np.exp(log_dwell))
    z = (means[:, None] - np.array([low, high])) / noise
    normal = np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * noise)
    reach = abs(high - low) + 6 * noise
    density = (1 - _BETWEEN) * normal + _BETWEEN / reach
    stay = np.array([[1 - jump, jump], [jump, 1 - jump]])
    return -_log_product(density[:, None, :] * stay)


def _log_product(matrices: FloatArray) -> float:
    """Return log of (1/2, 1/2) M_1 … M_n (1, 1)', of matrices of shape (n, 2, 2), multiplied in pairs."""
    total = 0.0
    while len(matrices) > 1:
        size = matrices.max(axis=(1, 2), keepdims=True)
        total += float(np.log(size).sum())
        matrices = matrices / size
        if len(matrices) % 2:
            matrices = np.concatenate([matrices, np.eye(2)[None]])
        matrices = np.matmul(matrices[::2], matrices[1::2])
    return total + float(np.log(0.5 * matrices[0].sum()))



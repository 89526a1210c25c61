"""The classical reading of slopes: each term where the Allan deviation runs at its slope.

N is read on the line of slope -1/2 at tau = 1 s, K on slope +1/2 at 3 s, B at the floor over 0.664,
Q and R on slopes -1 and +1; always with the exact Allan variance of the sampled term. Two things
make a reading unsure, and its interval holds both: the scatter of the points, whose covariance is
known, and what the other terms add to them, which is as much as their own readings say or, where
they have none, as the curve allows.

Source: IEEE Std 952-1997, Annex C.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray, read_only
from imucal.fit.av_goodness import goodness
from imucal.fit.av_intervals import CurveSpread
from imucal.fit.av_points import AvarPoints, avar_points, columns
from imucal.fit.av_search import Solution, Weight
from imucal.fit.av_select import dictionary
from imucal.fit.result import Estimate, Goodness, NoiseFit
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries

__all__ = ["SLOPES", "fit_slope"]

#: Slope of the Allan deviation of each term that can be read.
SLOPES = {"Q": -1.0, "N": -0.5, "B": 0.0, "K": 0.5, "R": 1.0}
#: A run of points has a slope if its line is within so much of it, half the way to the next slope at most.
_TOLERANCE = 0.15
#: Standard error of the slope of a run, at most: half the way to the next slope is two of them.
_SHARP = 0.125
#: Points, a factor of about two apart, that a line takes at least.
_LEAST_POINTS = 3
#: Points with fewer degrees of freedom show no slope.
_LEAST_EDF = 3.0
#: Points within this factor of the lowest are the floor.
_FLOOR = 1.05


_UNREAD = Goodness(statistic=np.nan, p_value=np.nan, chi2_per_bin=np.nan)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Reading:
    """One term's line: the logarithm of its coefficient, as weights on the points' logarithms."""

    symbol: str
    places: IntArray
    weights: FloatArray
    log_value: float


def fit_slope(
    series: AxisSeries | None,
    curve: AllanCurve,
    structure: tuple[str, ...] | None,
    *,
    level: float = 0.95,
    windows: Mapping[str, tuple[float, float]] | None = None,
) -> NoiseFit:
    """Read the terms of an Allan curve off its slopes.

    Parameters
    ----------
    series
        The samples that the curve was made of; None where only the curve is left.
    curve
        Allan variances, overlapping or standard.
    structure
        Symbols of the terms to read; None reads all that have their slope somewhere.
    level
        Confidence level of the intervals.
    windows
        Symbol -> first and last averaging time, in s, of the line it is read on, instead of the
        window found.

    Returns
    -------
    NoiseFit
        With N, B and K always among the estimates. A term without its slope, or one that the others
        explain, is bounded: alone it would lie above the curve.

    Raises
    ------
    ValueError
        If the structure holds GM, or a window holds no point.
    DataError
        If the curve has fewer than 2 averaging times, or is not of Allan variances.
    """
    if structure is not None and "GM" in structure:
        msg = "a Gauss-Markov term has no slope of its own to read; leave GM out or use method 'gmwm'"
        raise ValueError(msg)
    points = avar_points(series, curve)
    covariance = _log_covariance(points)
    wanted = [s for s in SLOPES if structure is None or s in structure]
    readings = [
        reading for symbol in wanted if (reading := _read(points, covariance, symbol, windows)) is not None
    ]
    estimates, shown = _estimates(points, covariance, readings, structure, level)
    solution = Solution(
        laws="".join(r.symbol for r in shown),
        times=np.zeros(0),
        variances=np.exp(2 * np.array([r.log_value for r in shown])),
        objective=float("nan"),
    )
    values = np.array([points.coefficient(r.symbol, float(np.exp(2 * r.log_value))) for r in shown])
    design = np.zeros((len(shown), points.size))
    for row, reading in zip(design, shown, strict=True):
        row[reading.places] = reading.weights
    logs = design @ covariance @ design.T
    fit = (
        goodness(points, solution, covariance * 4 * np.outer(points.avar, points.avar)) if shown else _UNREAD
    )
    return NoiseFit(
        method="slope",
        sensor=series.sensor if series is not None else None,
        rate_hz=series.rate_hz if series is not None else 1 / points.tau0,
        level=level,
        model=NoiseModel(terms=tuple(points.term(r.symbol, float(np.exp(2 * r.log_value))) for r in shown)),
        estimates=estimates,
        parameters=tuple(r.symbol for r in shown),
        covariance=read_only(logs * np.outer(values, values)),
        goodness=fit,
        curve=curve,
        used=np.unique(np.concatenate([points.used[:0], *(points.used[r.places] for r in shown)])),
        settings={
            "windows": {
                r.symbol: [float(points.m[r.places[k]] * points.tau0) for k in (0, -1)] for r in shown
            }
        },
    )


def _log_covariance(points: AvarPoints) -> FloatArray:
    """Return the covariance of the logarithms of the deviations, of whatever noise fits the curve."""
    rough = dictionary(points, Weight.of_deviations(points.avar))
    spread = CurveSpread.of_terms(points, rough.laws, rough.times).at(rough.variances)
    model = rough.avar(points.m)
    return np.asarray(spread / (4 * np.outer(model, model)))


def _read(
    points: AvarPoints,
    covariance: FloatArray,
    symbol: str,
    windows: Mapping[str, tuple[float, float]] | None,
) -> _Reading | None:
    """Return the reading of one term, or None where the curve has no such slope."""
    shape = np.sqrt(columns(points.m, symbol, np.zeros(0))[:, 0])
    if windows is not None and symbol in windows:
        places = _given(points, symbol, windows[symbol])
    else:
        places = _floor(points, covariance) if symbol == "B" else _line(points, covariance, SLOPES[symbol])
    if not places.size:
        return None
    weights = 1 / np.diag(covariance)[places]
    weights = weights / weights.sum()
    logs = np.log(np.sqrt(points.avar[places]) / shape[places])
    return _Reading(
        symbol=symbol,
        places=places,
        weights=weights,
        log_value=float(weights @ logs),
    )


def _given(points: AvarPoints, symbol: str, window: tuple[float, float]) -> IntArray:
    tau = points.m * points.tau0
    places = np.flatnonzero((tau >= window[0] * (1 - 1e-9)) & (tau <= window[1] * (1 + 1e-9)))
    if not places.size:
        msg = (
            f"window of {symbol}: no averaging time between {window[0]:g} and {window[1]:g} s; "
            f"the curve has {tau[0]:.4g} to {tau[-1]:.4g} s, a factor of about 2 apart"
        )
        raise ValueError(msg)
    return np.asarray(places, dtype=np.int64)


def _line(points: AvarPoints, covariance: FloatArray, slope: float) -> IntArray:
    """Return the longest run of points on a line of that slope; of equals, the surest."""
    x, y = np.log(points.m.astype(np.float64)), np.log(points.avar) / 2
    sure = int(np.sum(np.diag(covariance) < 1 / (2 * _LEAST_EDF)))
    best: tuple[float, float, IntArray] = (0.0, 0.0, np.zeros(0, dtype=np.int64))
    for first in range(sure):
        for last in range(first + _LEAST_POINTS, sure + 1):
            places = np.arange(first, last)
            found, spread = _slope(x[places], y[places], covariance[np.ix_(places, places)])
            steps = np.diff(y[places]) / np.diff(x[places])
            loose = _TOLERANCE + 2 * np.sqrt(_step_variance(x, covariance, places))
            if spread > _SHARP or abs(found - slope) > _TOLERANCE or np.any(np.abs(steps - slope) > loose):
                continue
            sharpness = -float(np.mean(np.diag(covariance)[places]))
            if (last - first, sharpness) > best[:2]:
                best = (last - first, sharpness, places)
    return best[2]


def _slope(x: FloatArray, y: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Return the weighted least-squares slope of y over x, and its standard error."""
    weight = 1 / np.diag(covariance)
    x = x - weight @ x / weight.sum()
    design = weight * x / ((weight * x) @ x)
    return float(design @ y), float(np.sqrt(design @ covariance @ design))


def _step_variance(x: FloatArray, covariance: FloatArray, places: IntArray) -> FloatArray:
    """Return the variance of the slope from each point of a run to the next."""
    a, b = places[:-1], places[1:]
    variance = np.diag(covariance)[a] + np.diag(covariance)[b] - 2 * covariance[a, b]
    return np.asarray(np.maximum(variance, 0.0) / np.square(x[b] - x[a]))


def _floor(points: AvarPoints, covariance: FloatArray) -> IntArray:
    """Return the points about the lowest, if the curve rises on both sides of it."""
    sure = int(np.sum(np.diag(covariance) < 1 / (2 * _LEAST_EDF)))
    if sure < _LEAST_POINTS:
        return np.zeros(0, dtype=np.int64)
    adev = np.sqrt(points.avar[:sure])
    lowest = int(np.argmin(adev))
    if lowest in {0, sure - 1}:
        return np.zeros(0, dtype=np.int64)
    first, last = lowest, lowest
    while first > 0 and adev[first - 1] <= _FLOOR * adev[lowest]:
        first -= 1
    while last < sure - 1 and adev[last + 1] <= _FLOOR * adev[lowest]:
        last += 1
    return np.arange(first, last + 1)


def _estimates(
    points: AvarPoints,
    covariance: FloatArray,
    readings: list[_Reading],
    structure: tuple[str, ...] | None,
    level: float,
) -> tuple[tuple[Estimate, ...], list[_Reading]]:
    """Return the estimates and the readings that are not explained by the others."""
    from scipy.special import ndtri

    quantile = float(ndtri((1 + level) / 2))
    found = {reading.symbol: reading for reading in readings}
    # A term that was not read may still be as large as the curve lets it.
    tops = {symbol: _ceiling(points, covariance, symbol, level) for symbol in SLOPES}
    logs = {symbol: found[symbol].log_value if symbol in found else tops[symbol] for symbol in SLOPES}
    names = [s for s in SLOPES if s in found or s in "NBK" or (structure is not None and s in structure)]
    estimates, shown = [], []
    for symbol in names:
        reading = found.get(symbol)
        share = 0.0 if reading is None else _share_of_others(points, reading, logs)
        if reading is None or share >= 1:
            high = points.coefficient(symbol, float(np.exp(2 * tops[symbol])))
            estimates.append(
                Estimate(key=symbol, symbol=symbol, status="bounded", value=None, low=0.0, high=high)
            )
            continue
        spread = quantile * np.sqrt(
            reading.weights @ covariance[np.ix_(reading.places, reading.places)] @ reading.weights
        )
        value = points.coefficient(symbol, float(np.exp(2 * reading.log_value)))
        estimates.append(
            Estimate(
                key=symbol,
                symbol=symbol,
                status="estimated",
                value=value,
                low=value * float(np.sqrt(1 - share) * np.exp(-spread)),
                high=value * float(np.exp(spread)),
            )
        )
        shown.append(reading)
    return tuple(estimates), shown


def _share_of_others(points: AvarPoints, reading: _Reading, logs: Mapping[str, float]) -> float:
    """Return how much of the Allan variance on a term's line the others may explain."""
    share = np.zeros(reading.places.size)
    for symbol, log_value in logs.items():
        if symbol != reading.symbol:
            alone = columns(points.m[reading.places], symbol, np.zeros(0))[:, 0]
            share += np.exp(2 * log_value) * alone / points.avar[reading.places]
    return float(reading.weights @ share)


def _ceiling(points: AvarPoints, covariance: FloatArray, symbol: str, level: float) -> float:
    """Return the logarithm of the largest coefficient whose term alone stays below the curve's limits.

    The limits are of a chi-squared law and hold for all points together (Bonferroni).
    """
    from scipy.special import chdtri

    edf = 1 / (2 * np.diag(covariance))
    tail = (1 - level) / (2 * points.size)
    shape = columns(points.m, symbol, np.zeros(0))[:, 0]
    high = np.log(points.avar / shape * edf / chdtri(edf, 1 - tail)) / 2
    return float(high.min())

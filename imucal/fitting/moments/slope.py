"""The classical reading of slopes: each term where the Allan deviation runs at its slope.

N is read on the line of slope -1/2 at tau = 1 s, K on slope +1/2 at 3 s, B at the floor over 0.664,
Q and R on slopes -1 and +1; always with the exact Allan variance of the sampled term. Two things
make a reading unsure, and its interval holds both: the scatter of the points, whose covariance is
known, and what the other terms add to them, which is as much as their own readings say or, where
they have none, as the curve allows.

Source: IEEE Std 952-1997, Annex C.

Where an Allan curve runs at a slope: the windows on which terms are read.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray, read_only
from imucal.fitting.moments.points import AvarPoints, avar_points, columns
from imucal.fitting.moments.search import CurveSpread, Solution, Weight, dictionary, goodness
from imucal.fitting.noise_fit import Estimate, Goodness, NoiseFit
from imucal.fitting.settings import FitSettings
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import AxisSeries

#: Slope of the Allan deviation of each term that can be read.
SLOPES = {symbol: term.slope for symbol, term in TERMS.items() if term.slope is not None}
#: A run of points has a slope if its line is within so much of it, half the way to the next slope at most.
_TOLERANCE = 0.15
#: Standard error of the slope of a run, at most: half the way to the next slope is two of them.
_SHARP = 0.125
#: Points, a factor of about two apart, that a line takes at least.
LEAST_POINTS = 3
#: Points with fewer degrees of freedom show no slope.
_LEAST_EDF = 3.0
#: Points within this factor of the lowest are the floor.
_FLOOR = 1.05


@dataclass(frozen=True, slots=True, eq=False)
class LogCurve:
    """Points, and the covariance of the logarithms of their deviations, shape (k, k)."""

    points: AvarPoints
    covariance: FloatArray

    @property
    def variance(self) -> FloatArray:
        """Variance of each logarithm, shape (k,)."""
        return np.diag(self.covariance)

    @property
    def sure(self) -> int:
        """How many of the points have enough degrees of freedom to show a slope."""
        return int(np.sum(self.variance < 1 / (2 * _LEAST_EDF)))

    def among(self, places: IntArray) -> FloatArray:
        """Return the covariance of some of the logarithms, shape (j, j)."""
        return self.covariance[np.ix_(places, places)]

    def shape(self, symbol: str) -> FloatArray:
        """Return the Allan variance of a term of unit variance at the points, shape (k,)."""
        return np.asarray(columns(self.points.m, [symbol])[:, 0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reading:
    """One term's line: the logarithm of its coefficient, as weights on the points' logarithms."""

    symbol: str
    places: IntArray
    weights: FloatArray
    log_value: float

    def spread(self, curve: LogCurve) -> float:
        """Return the standard error of `log_value`."""
        return float(np.sqrt(self.weights @ curve.among(self.places) @ self.weights))

    @property
    def variance(self) -> float:
        """Square of the coefficient, as a variance per sample."""
        return float(np.exp(2 * self.log_value))


def read_term(
    curve: LogCurve, symbol: str, windows: Mapping[str, tuple[float, float]] | None
) -> Reading | None:
    """Return the reading of one term, or None where the curve has no such slope."""
    if windows is not None and symbol in windows:
        places = _given(curve.points, symbol, windows[symbol])
    else:
        places = _floor(curve) if symbol == "B" else _line(curve, SLOPES[symbol])
    if not places.size:
        return None
    weights = 1 / curve.variance[places]
    weights = weights / weights.sum()
    logs = np.log(np.sqrt(curve.points.avar[places]) / np.sqrt(curve.shape(symbol))[places])
    return Reading(symbol=symbol, places=places, weights=weights, log_value=float(weights @ logs))


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


def _line(curve: LogCurve, slope: float) -> IntArray:
    """Return the longest run of points on a line of that slope; of equals, the surest."""
    x, y = np.log(curve.points.m.astype(np.float64)), np.log(curve.points.avar) / 2
    sure = curve.sure
    best: tuple[float, float, IntArray] = (0.0, 0.0, np.zeros(0, dtype=np.int64))
    for first in range(sure):
        for last in range(first + LEAST_POINTS, sure + 1):
            places = np.arange(first, last)
            found, spread = _slope(x[places], y[places], curve.among(places))
            steps = np.diff(y[places]) / np.diff(x[places])
            loose = _TOLERANCE + 3 * np.sqrt(_step_variance(x, curve.covariance, places))
            if spread > _SHARP or abs(found - slope) > _TOLERANCE or np.any(np.abs(steps - slope) > loose):
                continue
            sharpness = -float(np.mean(curve.variance[places]))
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


def _floor(curve: LogCurve) -> IntArray:
    """Return the points about the lowest, if the curve rises on both sides of it."""
    sure = curve.sure
    if sure < LEAST_POINTS:
        return np.zeros(0, dtype=np.int64)
    adev = np.sqrt(curve.points.avar[:sure])
    lowest = int(np.argmin(adev))
    if lowest in {0, sure - 1}:
        return np.zeros(0, dtype=np.int64)
    first, last = lowest, lowest
    while first > 0 and adev[first - 1] <= _FLOOR * adev[lowest]:
        first -= 1
    while last < sure - 1 and adev[last + 1] <= _FLOOR * adev[lowest]:
        last += 1
    return np.arange(first, last + 1)


def fit_slope(
    series: AxisSeries | None,
    curve: AllanCurve,
    settings: FitSettings,
    _temperature: FloatArray | None = None,
    *,
    windows: Mapping[str, tuple[float, float]] | None = None,
) -> NoiseFit:
    """Read the terms of an Allan curve off its slopes.

    Parameters
    ----------
    series
        The samples that the curve was made of; None where only the curve is left.
    curve
        Allan variances, overlapping or standard.
    settings
        Its model and level; ``auto`` reads all terms that have their slope somewhere.
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
        If a window holds no point.
    DataError
        If the curve has fewer than 2 averaging times, or is not of Allan variances.
    """
    structure, level = settings.structure, settings.level
    points = avar_points(series, curve)
    logs = _log_curve(points)
    wanted = [s for s in SLOPES if structure is None or s in structure]
    found = [read_term(logs, symbol, windows) for symbol in wanted]
    readings = {reading.symbol: reading for reading in found if reading is not None}
    estimates, shown = _estimates(logs, readings, structure, level)
    return NoiseFit(
        method="slope",
        sensor=series.sensor if series is not None else None,
        rate_hz=series.rate_hz if series is not None else 1 / points.tau0,
        level=level,
        model=NoiseModel(terms=tuple(points.term(r.symbol, r.variance) for r in shown)),
        estimates=estimates,
        parameters=tuple(r.symbol for r in shown),
        covariance=_covariance(logs, shown),
        goodness=_goodness(logs, shown),
        curve=curve,
        used=np.unique(np.concatenate([points.used[:0], *(points.used[r.places] for r in shown)])),
        settings={"windows": {r.symbol: _window(points, r) for r in shown}},
    )


def _window(points: AvarPoints, reading: Reading) -> list[float]:
    """Return the first and the last averaging time of a line, in s."""
    return [float(points.m[reading.places[k]] * points.tau0) for k in (0, -1)]


def _covariance(curve: LogCurve, shown: list[Reading]) -> FloatArray:
    """Return the covariance of the coefficients in SI, from that of the points' logarithms."""
    values = np.array([curve.points.coefficient(r.symbol, r.variance) for r in shown])
    design = np.zeros((len(shown), curve.points.size))
    for row, reading in zip(design, shown, strict=True):
        row[reading.places] = reading.weights
    return read_only(design @ curve.covariance @ design.T * np.outer(values, values))


def _goodness(curve: LogCurve, shown: list[Reading]) -> Goodness:
    """Return how well the terms together describe all points."""
    if not shown:
        return Goodness(statistic=np.nan, p_value=np.nan, chi2_per_bin=np.nan)
    solution = Solution(
        laws="".join(r.symbol for r in shown),
        times=np.zeros(0),
        variances=np.exp(2 * np.array([r.log_value for r in shown])),
        objective=float("nan"),
    )
    avar = curve.points.avar
    return goodness(curve.points, solution, curve.covariance * 4 * np.outer(avar, avar))


def _log_curve(points: AvarPoints) -> LogCurve:
    """Return the points with the covariance that they have under whatever noise fits the curve."""
    rough = dictionary(points, Weight.of_deviations(points.avar))
    spread = CurveSpread.of_solution(points, rough).at(rough.variances)
    model = rough.avar(points.m)
    return LogCurve(points, np.asarray(spread / (4 * np.outer(model, model))))


def _estimates(
    curve: LogCurve, found: Mapping[str, Reading], structure: tuple[str, ...] | None, level: float
) -> tuple[tuple[Estimate, ...], list[Reading]]:
    """Return the estimates and the readings that are not explained by the others."""
    from scipy.special import ndtri

    quantile = float(ndtri((1 + level) / 2))
    # A term that was not read may still be as large as the curve lets it.
    tops = {symbol: _ceiling(curve, symbol, level) for symbol in SLOPES}
    names = [s for s in SLOPES if s in found or s in ALWAYS or (structure is not None and s in structure)]
    estimates, shown = [], []
    for symbol in names:
        reading = found.get(symbol)
        share = 0.0 if reading is None else _share_of_others(curve, reading, found, tops)
        if reading is None or share >= 1:
            high = curve.points.coefficient(symbol, float(np.exp(2 * tops[symbol])))
            estimates.append(Estimate.bounded(symbol, symbol, high))
            continue
        spread = quantile * reading.spread(curve)
        value = curve.points.coefficient(symbol, reading.variance)
        low, high = value * float(np.sqrt(1 - share) * np.exp(-spread)), value * float(np.exp(spread))
        estimates.append(
            Estimate(key=symbol, symbol=symbol, status="estimated", value=value, low=low, high=high)
        )
        shown.append(reading)
    return tuple(estimates), shown


def _share_of_others(
    curve: LogCurve, reading: Reading, found: Mapping[str, Reading], tops: Mapping[str, float]
) -> float:
    """Return how much of a line's Allan variance the others, at two standard errors more, may explain."""
    places = reading.places
    share = np.zeros(places.size)
    for symbol in SLOPES:
        if symbol == reading.symbol:
            continue
        alone = curve.shape(symbol)[places]
        if symbol in found:
            variance = np.exp(2 * (found[symbol].log_value + 2 * found[symbol].spread(curve)))
        else:
            variance = min(np.exp(2 * tops[symbol]), _beside(curve, reading, alone))
        share += variance * alone / curve.points.avar[places]
    return float(reading.weights @ share)


def _beside(curve: LogCurve, reading: Reading, alone: FloatArray) -> float:
    """Return two standard errors more than the second term that the bend of a line shows, or infinity."""
    places = reading.places
    if places.size < LEAST_POINTS:
        return float("inf")
    both = np.stack([curve.shape(reading.symbol)[places], alone], axis=1)
    design = both / curve.points.avar[places, np.newaxis]
    inverse = np.linalg.inv(4 * curve.among(places))
    spread = np.linalg.inv(design.T @ inverse @ design)
    estimate = float((spread @ design.T @ inverse @ np.ones(places.size))[1])
    return max(estimate, 0.0) + 2 * float(np.sqrt(spread[1, 1]))


def _ceiling(curve: LogCurve, symbol: str, level: float) -> float:
    """Return the logarithm of the largest coefficient whose term alone stays below the curve's limits."""
    from scipy.special import chdtri

    # Chi-squared limits that hold for all points together (Bonferroni).
    edf = 1 / (2 * curve.variance)
    tail = (1 - level) / (2 * curve.points.size)
    high = np.log(curve.points.avar / curve.shape(symbol) * edf / chdtri(edf, 1 - tail)) / 2
    return float(high.min())

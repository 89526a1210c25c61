"""The classical reading of slopes: each term where the Allan deviation has its slope.

N is read on a line of slope -1/2 at tau = 1 s, K on slope +1/2 at 3 s, B at the floor divided by 0.664, and Q
and R on slopes -1 and +1. The interval of a reading includes the scatter of the points and the contribution
of the other terms: their own readings, or their largest values that the curve allows.

Source: IEEE Std 952-1997, Annex C.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Transform
from imucal.arrays import FloatArray, IntArray, read_only
from imucal.fitting.moments.points import AvarPoints, avar_points, columns, unit_terms
from imucal.fitting.moments.search import ROUGH, Solution, all_terms, goodness, minimum
from imucal.fitting.noise_fit import Estimate, Goodness, NoiseFit
from imucal.fitting.settings import FitSettings
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import AxisSeries

#: Slope of the Allan deviation of each term that can be read.
SLOPES = {symbol: term.slope for symbol, term in TERMS.items() if term.slope is not None}
#: Largest difference of a run's slope from a term's.
_TOLERANCE = 0.15
#: Largest standard error of the slope of a run: a quarter of the distance to the next slope.
_SHARP = 0.125
#: Minimum number of points of a line.
MIN_POINTS = 3
#: Minimum degrees of freedom of the points of a line.
_MIN_EDF = 3.0
#: Points within this factor of the lowest point are the floor.
_FLOOR = 1.05


@dataclass(frozen=True, eq=False)
class LogCurve:
    """Points, and the covariance of the logarithms of their deviations, shape (k, k)."""

    points: AvarPoints
    covariance: FloatArray

    @property
    def variance(self) -> FloatArray:
        return np.diag(self.covariance)

    @property
    def sure(self) -> int:
        """Number of points with enough degrees of freedom for a line."""
        return int(np.sum(self.variance < 1 / (2 * _MIN_EDF)))

    def among(self, places: IntArray) -> FloatArray:
        return self.covariance[np.ix_(places, places)]

    def shape(self, symbol: str) -> FloatArray:
        """Return the Allan variance of a term of unit variance at the points."""
        return np.asarray(columns(self.points.m, unit_terms([symbol]))[:, 0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """The reading of one term: `log_value` is the logarithm of the coefficient, `spread` its standard error.

    It is the mean of the points' logarithms with `weights`, shape (k,), which are 0 outside the line.
    """

    symbol: str
    weights: FloatArray
    log_value: float
    spread: float

    @property
    def places(self) -> IntArray:
        return np.flatnonzero(self.weights)

    @property
    def variance(self) -> float:
        return float(np.exp(2 * self.log_value))


def read_term(
    curve: LogCurve, symbol: str, windows: Mapping[str, tuple[float, float]] | None
) -> Reading | None:
    """Return the reading of one term, or None if the curve has no such slope."""
    if windows is not None and symbol in windows:
        (first, last), tau = windows[symbol], curve.points.m * curve.points.tau0
        places = np.flatnonzero((tau >= first * (1 - 1e-9)) & (tau <= last * (1 + 1e-9)))
        if not places.size:
            msg = (
                f"window of {symbol}: no averaging time between {first:g} and {last:g} s; "
                f"the curve has {tau[0]:.4g} to {tau[-1]:.4g} s, which differ by a factor of about 2"
            )
            raise ValueError(msg)
    else:
        places = _floor(curve) if symbol == "B" else _line(curve, SLOPES[symbol])
    if not places.size:
        return None
    weights = np.zeros(curve.points.size)
    weights[places] = 1 / curve.variance[places]
    weights /= weights.sum()
    logs = np.log(curve.points.avar / curve.shape(symbol)) / 2
    spread = float(np.sqrt(weights @ curve.covariance @ weights))
    return Reading(symbol=symbol, weights=weights, log_value=float(weights @ logs), spread=spread)


def _line(curve: LogCurve, slope: float) -> IntArray:
    """Return the longest run of points on a line of that slope, or the most precise of several."""
    x, y = np.log(curve.points.m.astype(np.float64)), np.log(curve.points.avar) / 2
    variance, width = curve.variance, np.diff(x)
    steps = np.diff(y) / width
    scatter = variance[:-1] + variance[1:] - 2 * np.diag(curve.covariance, 1)
    on_slope = np.abs(steps - slope) <= _TOLERANCE + 3 * np.sqrt(np.maximum(scatter, 0.0)) / width
    best: tuple[float, float, IntArray] = (0.0, 0.0, np.zeros(0, dtype=np.int64))
    for first in range(curve.sure):
        for last in range(first + MIN_POINTS, curve.sure + 1):
            if not on_slope[first : last - 1].all():
                break
            places = np.arange(first, last)
            weight = 1 / variance[places]
            away = weight * (x[places] - weight @ x[places] / weight.sum())
            design = away / (away @ x[places])
            spread = float(np.sqrt(design @ curve.among(places) @ design))
            if spread > _SHARP or abs(float(design @ y[places]) - slope) > _TOLERANCE:
                continue
            sharpness = -float(np.mean(variance[places]))
            if (last - first, sharpness) > best[:2]:
                best = (last - first, sharpness, places)
    return best[2]


def _floor(curve: LogCurve) -> IntArray:
    """Return the points near the lowest one if the curve rises on both sides."""
    adev = np.sqrt(curve.points.avar[: curve.sure])
    lowest = int(np.argmin(adev)) if adev.size else 0
    if lowest in {0, adev.size - 1}:
        return np.zeros(0, dtype=np.int64)
    away = np.flatnonzero(adev > _FLOOR * adev[lowest])
    first = away[away < lowest].max(initial=-1) + 1
    last = away[away > lowest].min(initial=adev.size) - 1
    return np.arange(first, last + 1)


def fit_slope(
    series: AxisSeries | None,
    curve: AllanCurve,
    settings: FitSettings,
    _temperature: FloatArray | None = None,
    _transform: Transform | None = None,
    *,
    windows: Mapping[str, tuple[float, float]] | None = None,
) -> NoiseFit:
    """Read terms from the slopes of overlapping or standard Allan variances; `series` may be None.

    A term that the others explain is bounded by the curve. `windows` maps symbols to the first and last
    averaging time in s of their lines; a window without points raises a ValueError. A curve with fewer than 2
    averaging times, or not of Allan variances, raises a DataError.
    """
    structure, level = settings.structure, settings.level
    points = avar_points(series, curve)
    rough = minimum(points, np.diag(1 / points.avar), all_terms(points, 1), tolerance=ROUGH)
    model = rough.avar(points)
    logs = LogCurve(points, np.asarray(rough.covariance(points) / (4 * np.outer(model, model))))
    wanted = [s for s in SLOPES if structure is None or s in structure]
    readings = {symbol: found for symbol in wanted if (found := read_term(logs, symbol, windows))}
    estimates, shown = _estimates(logs, readings, structure, level)
    lines = np.array([reading.weights for reading in shown]).reshape(-1, points.size)
    values = np.array([points.coefficient(r.symbol, r.variance) for r in shown])
    covariance = lines @ logs.covariance @ lines.T * np.outer(values, values)
    terms = unit_terms([reading.symbol for reading in shown])
    solution = Solution(terms=terms, variances=np.array([reading.variance for reading in shown]))
    none = Goodness(statistic=np.nan, p_value=np.nan, chi2_per_bin=np.nan)
    spread = logs.covariance * 4 * np.outer(points.avar, points.avar)
    tau = points.m * points.tau0
    sensor, rate_hz = (series.sensor, series.rate_hz) if series else (None, 1 / points.tau0)
    return NoiseFit(
        method="slope",
        sensor=sensor,
        rate_hz=rate_hz,
        level=level,
        model=solution.model(points),
        estimates=estimates,
        parameters=solution.symbols,
        covariance=read_only(covariance),
        goodness=goodness(points, solution, spread) if shown else none,
        curve=curve,
        used=points.used[lines.any(axis=0)],
        settings={"windows": {r.symbol: [float(tau[r.places[k]]) for k in (0, -1)] for r in shown}},
    )


def _estimates(
    curve: LogCurve, found: Mapping[str, Reading], structure: tuple[str, ...] | None, level: float
) -> tuple[tuple[Estimate, ...], list[Reading]]:
    """Return the estimates, and the readings that the other terms do not explain."""
    quantile = float(scipy.special.ndtri((1 + level) / 2))
    # A term that was not read may be as large as the curve allows (Bonferroni over its points).
    edf, avar = 1 / (2 * curve.variance), curve.points.avar
    least = scipy.special.chdtri(edf, 1 - (1 - level) / (2 * curve.points.size))
    tops = {s: float((np.log(avar / curve.shape(s) * edf / least) / 2).min()) for s in SLOPES}
    names = [s for s in SLOPES if s in found or s in ALWAYS or (structure is not None and s in structure)]
    estimates, shown = [], []
    for symbol in names:
        reading = found.get(symbol)
        share = 0.0 if reading is None else _share_of_others(curve, reading, found, tops)
        if reading is None or share >= 1:
            high = curve.points.coefficient(symbol, float(np.exp(2 * tops[symbol])))
            estimates.append(Estimate.bounded(symbol, symbol, high))
            continue
        spread = quantile * reading.spread
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
    """Return the share of a line's Allan variance that the other terms plus two standard errors explain."""
    share = np.zeros(curve.points.size)
    for symbol in SLOPES:
        if symbol == reading.symbol:
            continue
        if symbol in found:
            variance = np.exp(2 * (found[symbol].log_value + 2 * found[symbol].spread))
        else:
            variance = min(np.exp(2 * tops[symbol]), _variance_next_to(curve, reading, symbol))
        share += variance * curve.shape(symbol) / curve.points.avar
    return float(reading.weights @ share)


def _variance_next_to(curve: LogCurve, reading: Reading, symbol: str) -> float:
    """Return the upper limit (two standard errors) of another term from the bend of a line, or infinity."""
    places = reading.places
    if places.size < MIN_POINTS:
        return float("inf")
    both = np.stack([curve.shape(reading.symbol), curve.shape(symbol)], axis=1)
    design = (both / curve.points.avar[:, np.newaxis])[places]
    inverse = np.linalg.inv(4 * curve.among(places))
    spread = np.linalg.inv(design.T @ inverse @ design)
    estimate = float((spread @ design.T @ inverse @ np.ones(places.size))[1])
    return max(estimate, 0.0) + 2 * float(np.sqrt(spread[1, 1]))

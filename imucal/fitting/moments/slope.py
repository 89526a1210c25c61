"""The classical reading of slopes: each term where the Allan deviation runs at its slope.

N is read on the line of slope -1/2 at tau = 1 s, K on slope +1/2 at 3 s, B at the floor over 0.664,
Q and R on slopes -1 and +1; always with the exact Allan variance of the sampled term. Two things
make a reading unsure, and its interval holds both: the scatter of the points, whose covariance is
known, and what the other terms add to them, which is as much as their own readings say or, where
they have none, as the curve allows.

Source: IEEE Std 952-1997, Annex C.
"""

from collections.abc import Mapping

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, read_only
from imucal.fitting.moments.av_intervals import CurveSpread, goodness
from imucal.fitting.moments.av_points import AvarPoints, avar_points
from imucal.fitting.moments.av_search import Solution, Weight
from imucal.fitting.moments.av_select import dictionary
from imucal.fitting.moments.slope_lines import LEAST_POINTS, SLOPES, LogCurve, Reading, read_term
from imucal.fitting.noise_fit import Estimate, Goodness, NoiseFit
from imucal.fitting.settings import FitSettings
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS
from imucal.recording import AxisSeries


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
    spread = CurveSpread.of_terms(points, rough.laws, rough.times).at(rough.variances)
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

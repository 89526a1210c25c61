"""The model whose Allan variances are nearest to the measured ones, and the limits of its terms.

For given times, the weighted sum of squares J is a non-negative least-squares problem; times are searched on
a grid and refined. A backward elimination compares models by J plus a price per parameter (`CRITERIA`).

With weight W and covariance V of the Allan variances y, the estimate near its solution is
theta = (G'WG)^-1 G'W y, and its covariance is the sandwich of V. V depends on the variances, so an interval
contains the values v with

    (estimate - v)^2 / (s(estimate) s(v)) < chi-squared quantile,

where s(v) is the standard error if v were the true variance and the other variances were fitted to it.

Source: Andrews (1999), Econometrica 67, 543 (MMSC-BIC, MMSC-HQIC and MMSC-AIC); the eliminated variances:
Golub & Pereyra (1973), SIAM J. Numer. Anal. 10, 413.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, groupby, product

import numpy as np
import scipy

from imucal.allan.least_squares import non_negative
from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.fitting.moments.points import AvarPoints, columns, is_timed, spread_of, unit_terms
from imucal.fitting.noise_fit import MISFIT, Estimate, Goodness, Interval
from imucal.fitting.settings import CRITERIA, FitSettings
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import ALWAYS, TERMS, in_order, term_keys

#: Times per decade of the grid; places to refine.
_PER_DECADE, _STARTS = 3, 3
#: Tolerances of the sum of squares: for results, and for choosing a model.
_FINE, ROUGH = 1e-12, 1e-3
#: Tolerance of a limit, as a share of it.
_SHARP = 1e-6
#: Step of a log time for a derivative.
_STEP = 1e-4
#: Misfit above which the shortest averaging times are dropped, least ratio by which this must reduce it, and
#: largest number of octaves.
_FILTERED, _CURE, _MAX_DROPPED_OCTAVES = 5.0, 3.0, 8
#: Largest number of updates of the weight; three are usually enough.
_UPDATES = 5


def whitening(covariance: FloatArray) -> FloatArray:
    """Return W, shape (k, k), whose product W'W is the inverse of a covariance.

    Adding 1e-6 of each variance keeps the factorisation stable. A covariance without an inverse raises a
    DataError.
    """
    variance = np.diag(covariance)
    if not (np.all(np.isfinite(covariance)) and variance.min() > 0):
        msg = "no noise has this covariance of the Allan variances; expected noise, look at the samples"
        raise DataError(msg)
    deviation = np.sqrt(variance)
    correlation = covariance / np.outer(deviation, deviation) + 1e-6 * np.eye(deviation.size)
    try:
        factor = np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError as error:
        msg = (
            "no noise has Allan variances that rise or fall like these, so their covariance has no inverse; "
            "expected noise, look at the samples"
        )
        raise DataError(msg) from error
    return np.asarray(np.linalg.solve(factor, np.diag(1 / deviation)), dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """A model at its minimum, where `objective` is the weighted sum of squares.

    The terms have unit variance and times in samples, in the order of `TERMS`; times of one kind rise.
    `variances`, shape (p,), are per sample.
    """

    terms: tuple[NoiseTerm, ...]
    variances: FloatArray
    objective: float = float("nan")

    @property
    def symbols(self) -> tuple[str, ...]:
        return tuple(term.symbol for term in self.terms)

    @property
    def times(self) -> FloatArray:
        """Times of the terms that have one, in samples."""
        return np.array([time for term in self.terms for time in term.values[1:]])

    @property
    def parameters(self) -> int:
        return len(self.terms) + self.times.size

    def avar(self, points: AvarPoints) -> FloatArray:
        return columns(points.m, self.terms) @ self.variances

    def covariance(self, points: AvarPoints) -> FloatArray:
        return spread_of(points, self.terms).at(self.variances)

    def model(self, points: AvarPoints) -> NoiseModel:
        """Return the model in SI."""
        terms = (
            term.of(points.coefficient(term.symbol, own), *(time * points.tau0 for time in term.values[1:]))
            for term, own in zip(self.terms, self.variances.tolist(), strict=True)
        )
        return NoiseModel(terms=tuple(terms))


def time_grid(points: AvarPoints) -> FloatArray:
    """Return times in samples that the points can distinguish."""
    low, high = 0.7 * float(points.m[0]), 1.5 * float(points.m[-1])
    return np.geomspace(low, high, max(2, int(np.ceil(_PER_DECADE * np.log10(high / low)))))


def minimum(
    points: AvarPoints,
    weight: FloatArray,
    symbols: Sequence[str],
    *,
    near: FloatArray | None = None,
    tolerance: float = _FINE,
) -> Solution:
    """Return the minimum over the variances and times of terms.

    `weight` is the W of `whitening`. Times are searched from `near`, or on a grid.
    """
    symbols = in_order(symbols)
    target = weight @ points.avar

    def solved(times: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        matrix = weight @ columns(points.m, unit_terms(symbols, times))
        variances, objective = non_negative(matrix, target)
        return target - matrix @ variances, variances, objective

    kinds = [len(list(own)) for symbol, own in groupby(symbols) if is_timed(symbol)]
    times = np.zeros(0)
    if kinds:
        starts = _starts(points, weight, symbols) if near is None else [near]
        starts = starts[: _STARTS if tolerance == _FINE else 1]
        times = _refined(lambda logs: solved(np.exp(logs))[0], starts, points, tolerance)
        parts = np.split(times, np.cumsum(kinds)[:-1])
        times = np.concatenate([np.sort(part) for part in parts])
    _, variances, objective = solved(times)
    return Solution(terms=unit_terms(symbols, times), variances=variances, objective=objective)


def _starts(points: AvarPoints, weight: FloatArray, symbols: Sequence[str]) -> list[FloatArray]:
    grid, target = time_grid(points), weight @ points.avar
    fixed = weight @ columns(points.m, unit_terms([s for s in symbols if not is_timed(s)]))
    kinds = [(symbol, len(list(own))) for symbol, own in groupby(filter(is_timed, symbols))]
    shapes = [weight @ columns(points.m, unit_terms([symbol] * grid.size, grid)) for symbol, _ in kinds]
    chosen, costs = [], []
    for places in product(*(combinations(range(grid.size), count) for _, count in kinds)):
        parts = [shape[:, list(own)] for shape, own in zip(shapes, places, strict=True)]
        chosen.append(grid[list(chain.from_iterable(places))])
        costs.append(non_negative(np.hstack([fixed, *parts]), target)[1])
    return [chosen[i] for i in np.argsort(costs, kind="stable")]


def _refined(
    residuals: Callable[[FloatArray], FloatArray],
    starts: Sequence[FloatArray],
    points: AvarPoints,
    tolerance: float,
) -> FloatArray:
    grid = time_grid(points)
    low, high = float(np.log(grid[0])) - 1, float(np.log(grid[-1])) + 1
    found = [
        scipy.optimize.least_squares(
            residuals,
            np.clip(np.log(start), low + 1e-6, high - 1e-6),
            bounds=(low, high),
            xtol=1e-8,
            ftol=tolerance,
            gtol=tolerance,
        )
        for start in starts
    ]
    return np.exp(np.asarray(min(found, key=lambda one: float(one.cost)).x, dtype=np.float64))


def all_terms(points: AvarPoints, max_gm: int) -> tuple[str, ...]:
    """Return the symbols of the largest model with fewer parameters than points."""
    every = [(symbol, term) for symbol, term in TERMS.items() if "gmwm" in term.fitted_by]
    symbols = [symbol for symbol, term in every for _ in range(max_gm if term.repeatable else 1)]
    while len(symbols) > 1 and len(symbols) + sum(map(is_timed, symbols)) >= points.size:
        # Quantization noise first: few sensors have it.
        symbols.remove("Q" if "Q" in symbols else symbols[-1])
    return tuple(symbols)


@dataclass(frozen=True)
class CurveFit:
    """A fit, and the other models by how much worse they are."""

    solution: Solution
    weight: FloatArray
    misfit: float
    ranking: tuple[tuple[float, Solution], ...]


def best_fit(points: AvarPoints, eta3: FloatArray, settings: FitSettings) -> CurveFit:
    """Return the chosen or given model at its minimum, with the weight of the model itself.

    The search uses the weight of the largest model. If the chosen model has a misfit with its own weight, the
    previous, larger one is taken.
    """
    full = settings.weights == "full"
    if settings.structure is not None:
        start = minimum(points, eta3, settings.structure)
        if full and start.times.size:
            start = minimum(points, whitening(start.covariance(points)), settings.structure)
        return converged(points, start, eta3, full=full)
    price = CRITERIA[settings.criterion](points.n)
    largest = all_terms(points, settings.max_gm)
    weight = eta3
    if full:
        weight = whitening(minimum(points, eta3, largest, tolerance=ROUGH).covariance(points))
    trail = list(_smaller(points, weight, largest, price))
    values = {s.symbols: s.objective + price * s.parameters for tried in trail for s in tried}
    fits = []
    for tried in reversed(trail):
        fits.append(converged(points, tried[0], weight, full=full))
        if not fits[-1].misfit >= MISFIT:
            break
    found = fits[0] if fits[-1].misfit >= MISFIT else fits[-1]
    own = values[found.solution.symbols]
    others = {s.symbols: s for tried in trail for s in tried if values[s.symbols] > own}
    ranking = sorted(((values[name] - own, s) for name, s in others.items()), key=lambda pair: pair[0])
    return CurveFit(found.solution, found.weight, found.misfit, ((0.0, found.solution), *ranking))


def _smaller(
    points: AvarPoints, weight: FloatArray, symbols: tuple[str, ...], price: float
) -> Iterator[list[Solution]]:
    """Yield the models of each step of the backward elimination, the preferred one first."""
    tried = [minimum(points, weight, symbols, tolerance=ROUGH)]
    while True:
        yield tried
        current = tried[0]
        if len(current.terms) == 1:
            return
        fewer = {current.symbols[:i] + current.symbols[i + 1 :] for i in range(len(current.terms))}
        tried = []
        for own in sorted(fewer):
            near = current.times if sum(map(is_timed, own)) == current.times.size else None
            tried.append(minimum(points, weight, own, near=near, tolerance=ROUGH))
        tried.sort(key=lambda s: s.objective + price * s.parameters)
        saved = price * (current.parameters - tried[0].parameters)
        if tried[0].objective - current.objective > saved:
            return


def converged(points: AvarPoints, found: Solution, weight: FloatArray, *, full: bool) -> CurveFit:
    """Return the fit of a model from a solution; the `full` weight becomes that of the model itself."""
    for _ in range(_UPDATES if full else 0):
        weight = whitening(found.covariance(points))
        previous, found = found, minimum(points, weight, found.symbols, near=found.times)
        if np.allclose(found.variances, previous.variances, rtol=1e-3, atol=1e-12 * points.avar.max()):
            break
    misfit = goodness(points, found, found.covariance(points)).statistic
    return CurveFit(found, weight, misfit, ((0.0, found),))


def best_band(points: AvarPoints, eta3: FloatArray, settings: FitSettings) -> tuple[AvarPoints, CurveFit]:
    """Return the longest run of points, up to the last, that a model describes, and the fit.

    An output filter bends the curve at its first averaging times only. If no run is described, the one with
    the least misfit is taken if it is far better than the whole curve.
    """
    whole = best_fit(points, eta3, settings)
    if settings.weights == "eta3" or not whole.misfit >= _FILTERED:
        return points, whole
    structure = settings.structure
    least = 6 if structure is None else len(structure) + sum(map(is_timed, structure)) + 3
    best, bound = (points, whole), whole.misfit / _CURE
    for first in range(1, min(points.size - least, points.size // 2, _MAX_DROPPED_OCTAVES) + 1):
        kept = points.within(first)
        fit = best_fit(kept, eta3[first:, first:], settings)
        if fit.misfit < bound:
            best, bound = (kept, fit), fit.misfit
        if fit.misfit < MISFIT:
            break
    return best


def goodness(points: AvarPoints, solution: Solution, covariance: FloatArray) -> Goodness:
    """Return how well a model describes points with the given covariance.

    Cube roots of Allan variances are nearly normal even for few degrees of freedom (Wilson & Hilferty 1931).
    """
    model = solution.avar(points)
    tau = (float(points.m[0] * points.tau0), float(points.m[-1] * points.tau0))
    freedom = points.size - solution.parameters
    if freedom < 1 or not model.min() > 0:
        return Goodness(statistic=np.nan, p_value=np.nan, chi2_per_bin=np.nan, tau_s=tau)
    deviation = np.sqrt(np.diag(covariance))
    third = (deviation / model) ** 2 / 9
    score = (np.cbrt(points.avar / model) - (1 - third)) / np.sqrt(third)
    correlation = covariance / np.outer(deviation, deviation)
    misfit = float(score @ np.linalg.solve(correlation, score))
    p_value = float(scipy.special.chdtrc(freedom, misfit))
    # Beyond the range of a normal quantile, use Wilson and Hilferty's approximation.
    spread = 2 / (9 * freedom)
    statistic = (
        float(-scipy.special.ndtri(p_value))
        if p_value > 1e-15
        else (np.cbrt(misfit / freedom) - 1 + spread) / spread**0.5
    )
    return Goodness(statistic=float(statistic), p_value=p_value, chi2_per_bin=misfit / freedom, tau_s=tau)


def limits(value: float, spread_at: Callable[[float], float], quantile: float) -> tuple[float, float]:
    """Return the interval of a variance, estimated as `value`; its lower limit is 0 if 0 is inside.

    `spread_at` returns the standard error if its argument were the true variance.
    """
    own = spread_at(value)

    def excess(trial: float) -> float:
        return (value - trial) ** 2 - quantile * own * spread_at(trial)

    low = scipy.optimize.brentq(excess, 0.0, value, xtol=_SHARP * value) if excess(0.0) > 0 else 0.0
    high = value + np.sqrt(quantile) * own
    for _ in range(200):
        if excess(high) > 0:
            return low, scipy.optimize.brentq(excess, value, high, xtol=_SHARP * high)
        high = value + 2 * (high - value)
    return low, float("inf")


def term_limits(
    points: AvarPoints, solution: Solution, weight: FloatArray, place: int, quantile: float
) -> tuple[float, float]:
    """Return the limits of the variance of the term at `place`, with fixed times."""
    if solution.parameters > points.size:
        return 0.0, float("inf")
    design, target = weight @ columns(points.m, solution.terms), weight @ points.avar
    own = influence(points, solution, weight, free=place)[place]
    spread, others = spread_of(points, solution.terms), np.arange(len(solution.terms)) != place

    def spread_at(trial: float) -> float:
        at = np.full(others.size, trial)
        if others.any():
            at[others] = non_negative(design[:, others], target - trial * design[:, place])[0]
        return float(np.sqrt(own @ spread.at(at) @ own))

    return limits(float(solution.variances[place]), spread_at, quantile)


def influence(points: AvarPoints, solution: Solution, weight: FloatArray, *, free: int = -1) -> FloatArray:
    """Return the derivatives of p variances, then of the logarithms of p times, by the Allan variances.

    Shape (2p, k). Rows are zero for variances at zero, except the one at place `free`.
    """
    symbols, times = solution.symbols, solution.times
    moved = [columns(points.m, unit_terms(symbols, times * np.exp(step))) for step in (_STEP, -_STEP)]
    slopes = (moved[0] - moved[1]) / (2 * _STEP) * solution.variances
    used = (solution.variances > 0) | (np.arange(len(symbols)) == free)
    timed = used & np.array([is_timed(symbol) for symbol in symbols])
    design = weight @ np.hstack([columns(points.m, solution.terms) * used, slopes * timed])
    length = np.sqrt(np.einsum("ij,ij->j", design, design))
    length[length == 0] = 1.0
    # Terms that the curve can't distinguish get wide limits, not an error.
    return np.asarray(np.linalg.pinv(design / length, rcond=1e-12) @ weight / length[:, np.newaxis])


def curve_estimates(
    points: AvarPoints, solution: Solution, weight: FloatArray, *, level: float
) -> tuple[tuple[Estimate, ...], tuple[str, ...], FloatArray]:
    """Return estimates of the model's terms and of N, B and K, and names and covariance of the parameters."""
    quantile = float(scipy.special.chdtri(1, 1 - level))
    slopes_of = influence(points, solution, weight)
    scatter = slopes_of @ solution.covariance(points) @ slopes_of.T
    own = term_keys(solution.symbols)
    every = term_keys(in_order((*solution.symbols, *(s for s in ALWAYS if s not in solution.symbols))))
    estimates: list[Estimate] = []
    gradient: dict[str, float] = {}
    rows: list[int] = []
    for key in every:
        if key not in own:
            wider = minimum(points, weight, (*solution.symbols, key), near=solution.times)
            high = term_limits(points, wider, weight, wider.symbols.index(key), quantile)[1]
            estimates.append(Estimate.bounded(key, key, points.coefficient(key, high)))
            continue
        place = own.index(key)
        time_row = len(own) + place
        variance = float(solution.variances[place])
        variances = (variance, *term_limits(points, solution, weight, place, quantile))
        # The logarithm of a time is closer to normal than the time.
        factor = float(np.exp(min(np.sqrt(quantile * scatter[time_row, time_row]), 50.0)))
        estimate = _estimate(points, key, solution.terms[place], variances, factor)
        estimates.append(estimate)
        if estimate.value is not None:
            (name, slope), *times = estimate.slopes().items()
            # By the variance, not by its logarithm.
            gradient |= {name: slope / variance, **dict(times)}
            rows += [place, time_row][: 1 + len(times)]
    slopes = np.array(list(gradient.values()))
    covariance = scatter[np.ix_(rows, rows)] * np.outer(slopes, slopes)
    return tuple(estimates), tuple(gradient), np.asarray(covariance, dtype=np.float64)


def _estimate(
    points: AvarPoints, key: str, term: NoiseTerm, variances: tuple[float, float, float], factor: float
) -> Estimate:
    value, low, high = (points.coefficient(term.symbol, variance) for variance in variances)
    if not low > 0:
        return Estimate.bounded(key, term.symbol, high)
    time = None
    if is_timed(term.symbol):
        own = float(term.values[1]) * points.tau0
        time = Interval(value=own, low=own / factor, high=own * factor)
    return Estimate(
        key=key,
        symbol=term.symbol,
        status="estimated",
        value=value,
        low=low,
        high=high,
        correlation_time=time,
    )

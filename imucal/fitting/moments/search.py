"""The minimum of a weighted sum of squares of Allan variances, over every non-negative model.

The model is linear in the variances, so for given correlation times the minimum is a non-negative
least-squares problem, which has one solution and needs no start. Correlation times are searched on
a grid that covers the curve and refined from its best places. The result is the same every time.

Estimates with intervals, covariance and misfit of a model that was fitted to Allan variances.

With weight W and covariance V of the Allan variances y, the estimate is linear near its solution,
theta = (G'WG)^-1 G'W y, and its covariance the sandwich of V. V itself depends on the variances:
the larger the true variance, the wider the spread. An interval therefore holds the values v with

    (estimate - v)^2 / (s(estimate) s(v)) < chi-squared quantile,

where s(v) is the standard error if v were true. Where V is proportional to v^2 this is the interval
of a logarithm; where other terms make the spread, it is Wald's; it always has an upper end.

The choice of terms (every subset, by a criterion of moment selection) and of averaging times.

The sum of squares J with the inverse covariance as weight is chi-squared with (points - parameters)
degrees of freedom where the model is right. Models are ranked by J + parameters * penalty, with
penalty ln n (``bic``), 2 ln ln n (``hq``) or 2 (``aic``), n the number of samples.

Source: Andrews (1999), "Consistent moment selection procedures for generalized method of moments
estimation", Econometrica 67, 543: the criteria MMSC-BIC, MMSC-HQIC and MMSC-AIC.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, groupby, product

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.errors import DataError
from imucal.fitting.moments.points import (
    AvarCovariance,
    AvarPoints,
    avar_covariance,
    columns,
    parts_of,
    processes,
)
from imucal.fitting.noise_fit import Estimate, Goodness, Interval
from imucal.fitting.settings import CRITERIA, FitSettings
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS, GaussMarkov, in_order, term_keys
from imucal.solvers import non_negative, root

#: Correlation times a decade in the grid.
_PER_DECADE = 5
#: Places of the grid from which a search is refined.
_STARTS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weight:
    """The weight matrix Omega = whiten' whiten of a sum of squares; `whiten` has shape (k, k)."""

    whiten: FloatArray

    @classmethod
    def of_covariance(cls, covariance: FloatArray) -> "Weight":
        """Return the inverse of a covariance of shape (k, k).

        The covariance is known to some 1e-3 (its lags are summed on a grid), so a nugget of 1e-6
        of each variance changes nothing and keeps the factorisation safe.

        Raises
        ------
        DataError
            If the covariance is of no noise, as that of a curve that falls by many decades.
        """
        variance = np.diag(covariance)
        if not (np.all(np.isfinite(covariance)) and variance.min() > 0):
            msg = (
                "the covariance of the Allan variances is not that of any noise; expected noise, look at the "
                "samples"
            )
            raise DataError(msg)
        deviation = np.sqrt(variance)
        correlation = covariance / np.outer(deviation, deviation) + 1e-6 * np.eye(deviation.size)
        try:
            factor = np.linalg.cholesky(correlation)
        except np.linalg.LinAlgError as error:
            msg = (
                "the Allan variances fall or rise as those of no noise do, so their covariance has no "
                "inverse; expected noise, look at the samples"
            )
            raise DataError(msg) from error
        return cls(whiten=np.linalg.solve(factor, np.diag(1 / deviation)))

    @classmethod
    def of_deviations(cls, deviations: FloatArray) -> "Weight":
        """Return the diagonal weight 1 / deviation^2, shape (k,)."""
        return cls(whiten=np.diag(1 / deviations))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """A model at its minimum: its terms, their variances per sample, the sum of squares.

    Attributes
    ----------
    laws, kinds
        Symbols of the terms without a time, such as N, B and K, and of those with one.
    times
        Correlation times in samples, shape (g,), those of one kind rising.
    variances
        Variances per sample of the laws, then of the terms with a time, shape (p,).
    objective
        Weighted sum of squares.
    """

    laws: Sequence[str]
    kinds: Sequence[str] = ()
    times: FloatArray
    variances: FloatArray
    objective: float

    @property
    def parameters(self) -> int:
        """Number of free parameters."""
        return len(self.laws) + 2 * self.times.size

    def avar(self, m: IntArray) -> FloatArray:
        """Return the model's Allan variance, shape (k,)."""
        return columns(m, self.laws, self.kinds, self.times) @ self.variances


def time_grid(m: IntArray, per_decade: int = _PER_DECADE) -> FloatArray:
    """Return correlation times in samples that the Allan variances at `m` can tell, shape (g,)."""
    low, high = 0.7 * float(m[0]), 1.5 * float(m[-1])
    return np.geomspace(low, high, max(2, int(np.ceil(per_decade * np.log10(high / low)))))


def minimise(
    m: IntArray,
    avar: FloatArray,
    weight: Weight,
    laws: Sequence[str],
    kinds: Sequence[str],
    *,
    near: FloatArray | None = None,
) -> Solution:
    """Return the global minimum over the variances and the correlation times.

    Parameters
    ----------
    m, avar
        Averaging factors and Allan variances, shape (k,).
    weight
        Of the sum of squares.
    laws, kinds
        Symbols of the terms without a time and of those with one, neighbours where they are the same.
    near
        Correlation times of a minimum with another weight, shape (g,): they and the best place
        of the grid are refined then, instead of the best few.
    """
    target = weight.whiten @ avar
    fixed = weight.whiten @ columns(m, laws)
    if not kinds:
        variances, objective = non_negative(fixed, target)
        return Solution(laws=laws, kinds=(), times=np.zeros(0), variances=variances, objective=objective)
    grid = time_grid(m, _PER_DECADE if len(kinds) <= 2 else 3)
    varied = {kind: weight.whiten @ columns(m, (), [kind] * grid.size, grid) for kind in kinds}
    starts = _best_of_grid(fixed, varied, target, grid, kinds)
    if near is not None:
        starts = [near, starts[0]]

    bounds = (np.log(grid[0]) - 1, np.log(grid[-1]) + 1)

    def residuals(logs: FloatArray) -> FloatArray:
        matrix = np.hstack([fixed, weight.whiten @ columns(m, (), kinds, np.exp(logs))])
        return np.asarray(target - matrix @ non_negative(matrix, target)[0])

    found = [_refined(residuals, np.log(start), bounds) for start in starts]
    times = np.exp(min(found, key=lambda pair: pair[1])[0])
    times = times[np.lexsort((times, np.array([kinds.index(kind) for kind in kinds])))]
    matrix = np.hstack([fixed, weight.whiten @ columns(m, (), kinds, times)])
    variances, objective = non_negative(matrix, target)
    return Solution(laws=laws, kinds=kinds, times=times, variances=variances, objective=objective)


def _best_of_grid(
    fixed: FloatArray,
    varied: dict[str, FloatArray],
    target: FloatArray,
    grid: FloatArray,
    kinds: Sequence[str],
) -> list[FloatArray]:
    """Return the correlation times of the best few places of the grid."""
    places = _grid_places(kinds, grid.size)
    costs = [
        non_negative(
            np.column_stack([fixed, *(varied[kind][:, at] for kind, at in zip(kinds, place, strict=True))]),
            target,
        )[1]
        for place in places
    ]
    order = np.argsort(costs, kind="stable")[: _STARTS * len(kinds)]
    return [grid[list(places[index])] for index in order]


def _grid_places(kinds: Sequence[str], size: int) -> list[tuple[int, ...]]:
    """Return every set of places in a grid of times, those of one kind rising."""
    own = [combinations(range(size), len(list(terms))) for _, terms in groupby(kinds)]
    return [tuple(place for places in one for place in places) for one in product(*own)]


def _refined(
    residuals: Callable[[FloatArray], FloatArray], start: FloatArray, bounds: tuple[float, float]
) -> tuple[FloatArray, float]:
    """Return the minimum near `start` and its sum of squares, by Gauss-Newton steps.

    Source: Golub & Pereyra (1973), SIAM J. Numer. Anal. 10, 413: the linear parameters are
    eliminated from the residuals.
    """
    from scipy.optimize import least_squares

    inside = np.clip(start, bounds[0] + 1e-6, bounds[1] - 1e-6)
    found = least_squares(residuals, inside, bounds=bounds, xtol=1e-8, ftol=1e-12, gtol=1e-12)
    return np.asarray(found.x, dtype=np.float64), 2 * float(found.cost)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurveSpread:
    """The covariance of the Allan variances of a curve, for any variances of a set of terms."""

    points: AvarPoints
    laws: Sequence[str]
    times: FloatArray
    gaussian: AvarCovariance

    @classmethod
    def of_solution(cls, points: AvarPoints, solution: Solution) -> "CurveSpread":
        """Return it for the terms of a model."""
        every = processes(solution.laws, solution.kinds, solution.times)
        gaussian = avar_covariance(points.m, points.n, every, overlapping=points.overlapping)
        return cls(points=points, laws=solution.laws, times=solution.times, gaussian=gaussian)

    def within(self, first: int) -> "CurveSpread":
        """Return it for the points from index `first` on."""
        return replace(self, points=self.points.within(first), gaussian=self.gaussian.within(first))

    def at(self, variances: FloatArray) -> FloatArray:
        """Return the covariance, shape (k, k), at variances in the order of `columns`.

        White noise of excess kurtosis g adds g avar_i avar_j / n, avar its own Allan variance:
        each Allan variance is a mean of squares in which every sample weighs the same.
        """
        ramps = [place for place, law in enumerate(self.laws) if law == "R"]
        covariance = self.gaussian.at(np.delete(variances, ramps), float(variances[ramps].sum()))
        if self.points.excess and "N" in self.laws:
            white = float(variances[self.laws.index("N")]) / self.points.m
            covariance = covariance + self.points.excess * np.outer(white, white) / self.points.n
        return covariance


def derivatives(solution: Solution, points: AvarPoints, free: np.ndarray) -> FloatArray:
    """Return the derivatives of the model by its free variances and log correlation times."""
    step = 1e-4
    plain = columns(points.m, solution.laws, solution.kinds, solution.times)[:, free]
    count = solution.times.size
    if count == 0:
        return plain
    later = columns(points.m, (), solution.kinds, solution.times * np.exp(step))
    sooner = columns(points.m, (), solution.kinds, solution.times * np.exp(-step))
    slopes = (later - sooner) / (2 * step) * solution.variances[-count:]
    return np.hstack([plain, slopes[:, free[-count:]]])


def limits(value: float, spread_at: Callable[[float], float], quantile: float) -> tuple[float, float]:
    """Return the interval of a variance; its lower end is 0 where 0 is inside.

    Parameters
    ----------
    value
        The estimate, at least 0.
    spread_at
        Returns the standard error of the estimate if its argument were the true variance.
    quantile
        Chi-squared quantile with one degree of freedom.
    """
    own = spread_at(value)

    def excess(trial: float) -> float:
        return (value - trial) ** 2 - quantile * own * spread_at(trial)

    low = 0.0
    if excess(0.0) > 0:
        low = root(excess, 0.0, value, tolerance=1e-6 * value)
    high = value + np.sqrt(quantile) * own
    for _ in range(200):
        if excess(high) > 0:
            break
        high = value + 2 * (high - value)
    else:
        return low, float("inf")
    return low, root(excess, value, high, tolerance=1e-6 * high)


def goodness(points: AvarPoints, solution: Solution, covariance: FloatArray) -> Goodness:
    """Return how well a model describes the points, whose covariance it is given.

    An Allan variance with few degrees of freedom is far from normal; its cube root is not (Wilson
    & Hilferty 1931). The sum of squares is of those, with the correlations of `covariance`.
    """
    from scipy.special import chdtrc, ndtri

    model = solution.avar(points.m)
    tau = (float(points.m[0] * points.tau0), float(points.m[-1] * points.tau0))
    freedom = points.size - solution.parameters
    if freedom < 1 or not model.min() > 0:
        # Nothing is left to judge by, or the model is no noise at all.
        return Goodness(statistic=np.nan, p_value=np.nan, chi2_per_bin=np.nan, tau_s=tau)
    deviation = np.sqrt(np.diag(covariance))
    third = 2 / 9 * (deviation / model) ** 2 / 2
    score = (np.cbrt(points.avar / model) - (1 - third)) / np.sqrt(third)
    correlation = covariance / np.outer(deviation, deviation)
    misfit = float(score @ np.linalg.solve(correlation, score))
    p_value = float(chdtrc(freedom, misfit))
    # Beyond what a normal score can say, Wilson and Hilferty's own approximation goes on.
    spread = 2 / (9 * freedom)
    statistic = (
        float(-ndtri(p_value)) if p_value > 1e-15 else (np.cbrt(misfit / freedom) - 1 + spread) / spread**0.5
    )
    return Goodness(statistic=float(statistic), p_value=p_value, chi2_per_bin=misfit / freedom, tau_s=tau)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurveEstimates:
    """The estimates, the covariance of those that are not bounded, and that of the Allan variances."""

    estimates: tuple[Estimate, ...]
    parameters: tuple[str, ...]
    covariance: FloatArray
    curve_covariance: FloatArray


def model_of(points: AvarPoints, solution: Solution) -> NoiseModel:
    """Return the model of a solution, its terms in the usual order."""
    count = len(solution.laws)
    terms = [points.term(law, float(v)) for law, v in zip(solution.laws, solution.variances, strict=False)]
    shaped = zip(solution.kinds, solution.variances[count:], solution.times, strict=True)
    terms += [points.term(kind, float(v), float(time)) for kind, v, time in shaped]
    return NoiseModel(terms=tuple(sorted(terms, key=lambda term: list(TERMS).index(term.symbol))))


def curve_estimates(
    points: AvarPoints, solution: Solution, weight: Weight, *, level: float
) -> CurveEstimates:
    """Return an estimate of every term of the model, and of N, B and K.

    A term that is not in the model gets the upper bound that it has when it is added.
    """
    laws = in_order({*solution.laws, *ALWAYS})
    padded = _padded(solution, laws)
    spread = CurveSpread.of_solution(points, padded)
    reader = _Reader(spread, weight, padded, solution.laws, level)
    symbols = in_order([*laws, *solution.kinds])
    shaped = iter(range(len(laws), len(symbols)))
    places = [laws.index(s) if s in laws else next(shaped) for s in symbols]
    entries = [
        (reader.estimate(place, key, symbol), place)
        for place, key, symbol in zip(places, term_keys(symbols), symbols, strict=True)
    ]
    names, covariance = reader.covariance([(e, place) for e, place in entries if e.value is not None])
    return CurveEstimates(
        estimates=tuple(estimate for estimate, _ in entries),
        parameters=names,
        covariance=covariance,
        curve_covariance=spread.at(reader.solution.variances),
    )


def _padded(solution: Solution, laws: Sequence[str]) -> Solution:
    """Return the solution with the laws it lacks, at variance 0."""
    given = dict(zip(solution.laws, solution.variances, strict=False))
    variances = [given.get(law, 0.0) for law in laws]
    return replace(
        solution, laws=laws, variances=np.append(variances, solution.variances[len(solution.laws) :])
    )


class _Reader:
    """Reads estimates off a solution; `own` are the laws of the model itself."""

    def __init__(
        self, spread: CurveSpread, weight: Weight, solution: Solution, own: Sequence[str], level: float
    ) -> None:
        from scipy.special import chdtri

        self.points, self.spread, self.weight, self.solution = spread.points, spread, weight, solution
        self.quantile = float(chdtri(1, 1 - level))
        self.design = weight.whiten @ columns(self.points.m, solution.laws, solution.kinds, solution.times)
        self.target = weight.whiten @ self.points.avar
        self.inside = np.array([law in own for law in solution.laws] + [True] * solution.times.size)
        self.free = self.inside & (solution.variances > 0)
        self.count = len(solution.laws)

    def estimate(self, place: int, key: str, symbol: str) -> Estimate:
        low, high = self._interval(place)
        to_si = self.points.coefficient
        if not (low > 0 and self.inside[place]):
            return Estimate.bounded(key, symbol, to_si(symbol, high))
        return Estimate(
            key=key,
            symbol=symbol,
            status="estimated",
            value=to_si(symbol, float(self.solution.variances[place])),
            low=to_si(symbol, low),
            high=to_si(symbol, high),
            correlation_time=self._time(place - self.count) if place >= self.count else None,
        )

    def _scatter(self, at: FloatArray, free: np.ndarray) -> FloatArray:
        """Return the covariance of the free variances, then log times, where the curve's is that of `at`."""
        rows = self._influence(free)
        return np.asarray(rows @ self.spread.at(at) @ rows.T)

    def _influence(self, free: np.ndarray) -> FloatArray:
        """Return what each Allan variance adds to the free variances, then log times, shape (p, k)."""
        design = self.weight.whiten @ derivatives(self.solution, self.points, free)
        length = np.sqrt(np.einsum("ij,ij->j", design, design))
        length[length == 0] = 1.0
        # Of minimal norm, so that terms the curve can't tell apart give a wide answer, not an error.
        solve = np.linalg.pinv(design / length, rcond=1e-12) @ self.weight.whiten
        return np.asarray(solve / length[:, np.newaxis])

    def _time(self, index: int) -> Interval:
        """Return the correlation time in s; its logarithm is closer to normal than itself."""
        covariance = self._scatter(self.solution.variances, self.free)
        place = int(self.free.sum()) + int(self.free[self.count : self.count + index].sum())
        deviation = np.sqrt(self.quantile * covariance[place, place])
        value = float(self.solution.times[index]) * self.points.tau0
        factor = float(np.exp(min(deviation, 50.0)))
        return Interval(value=value, low=value / factor, high=value * factor)

    def _interval(self, place: int) -> tuple[float, float]:
        """Return the limits of one variance per sample."""
        free = self.free.copy()
        free[place] = True
        if int(free.sum()) + int(free[self.count :].sum()) > self.points.size:
            return 0.0, float("inf")
        value = float(self.solution.variances[place])
        if not self.inside[place]:
            used = np.flatnonzero(self.inside | (np.arange(self.inside.size) == place))
            value = float(non_negative(self.design[:, used], self.target)[0][used.tolist().index(place)])
        own = self._influence(free)[int(free[:place].sum())]

        def spread_at(trial: float) -> float:
            variance = own @ self.spread.at(self._others(place, trial)) @ own
            return float(np.sqrt(variance))

        return limits(value, spread_at, self.quantile)

    def _others(self, place: int, trial: float) -> FloatArray:
        """Return the best variances with the one at `place` held at `trial`, shape (p,)."""
        others = np.flatnonzero(self.inside & (np.arange(self.inside.size) != place))
        at = np.zeros(self.inside.size)
        if others.size:
            rest = self.target - trial * self.design[:, place]
            at[others] = non_negative(self.design[:, others], rest)[0]
        at[place] = trial
        return at

    def covariance(self, shown: list[tuple[Estimate, int]]) -> tuple[tuple[str, ...], FloatArray]:
        """Return the parameters' names and the covariance of their coefficients in SI."""
        raw = self._scatter(self.solution.variances, self.free)
        names: list[str] = []
        rows: list[int] = []
        slopes: list[float] = []
        for estimate, place in shown:
            value, variance = estimate.value or 0.0, float(self.solution.variances[place])
            names.append(TERMS[estimate.symbol].parameter_names(estimate.key)[0])
            rows.append(int(self.free[:place].sum()))
            slopes.append(value / (2 * variance))
            if estimate.correlation_time is not None:
                names.append(f"{estimate.key}.T")
                rows.append(int(self.free.sum()) + int(self.free[self.count : place].sum()))
                slopes.append(estimate.correlation_time.value)
        covariance = raw[np.ix_(rows, rows)] * np.outer(slopes, slopes)
        return tuple(names), np.asarray(covariance, dtype=np.float64)


_LAWS = "QNBKR"
#: Models whose screened criterion is within so much of the best are computed in full, at most so many.
_WITHIN, _AT_MOST = 10.0, 10
#: A misfit above so many standard deviations means that the model does not describe the curve.
MISFIT = 3.0
#: A misfit of all averaging times above this makes the fit look whether the shortest are to blame.
_FILTERED = 5.0
#: They are, where the misfit without them is less by this factor.
_CURE = 3.0
#: At most so many octaves are left out: an output filter leaves the rest of the curve as it was.
_MOST_DROPPED = 8
#: The weight is computed anew at most so often; three are enough in practice.
_STEPS = 5
#: At most so many models are tried for one that describes the curve.
_CANDIDATES = 6


def dictionary(points: AvarPoints, weight: Weight) -> Solution:
    """Return the best fit of all laws and Gauss-Markov terms of many correlation times at once.

    It describes almost any curve; the terms left at zero are dropped.
    """
    grid = time_grid(points.m, per_decade=3)
    matrix = weight.whiten @ columns(points.m, _LAWS, [GaussMarkov.symbol] * grid.size, grid)
    variances, objective = non_negative(matrix, weight.whiten @ points.avar)
    laws = tuple(law for law, value in zip(_LAWS, variances, strict=False) if value > 0)
    active = variances[len(_LAWS) :] > 0
    kept = np.concatenate([variances[: len(_LAWS)], variances[len(_LAWS) :][active]])
    kinds = [GaussMarkov.symbol] * int(active.sum())
    return Solution(laws=laws, kinds=kinds, times=grid[active], variances=kept[kept > 0], objective=objective)


def choose(
    points: AvarPoints, weight: Weight, *, criterion: str, max_gm: int
) -> list[tuple[float, Solution]]:
    """Return the best models and how much worse their criterion is, the best (0) first.

    Notes
    -----
    All sets of the five laws with up to `max_gm` Gauss-Markov terms at the correlation times of a
    grid are screened by their normal equations at once; a solution with a negative variance is one
    of a smaller model. The best are then computed with free correlation times.
    """
    price = CRITERIA[criterion](points.n)
    screened = sorted(_screen(points, weight, max_gm, price), key=lambda entry: entry[0])
    if not screened:
        return []
    near = [entry for entry in screened if entry[0] <= screened[0][0] + _WITHIN][:_AT_MOST]
    solutions = [minimise(points.m, points.avar, weight, laws, kinds) for _, laws, kinds in near]
    ranked = sorted(((s.objective + price * s.parameters, s) for s in solutions), key=lambda pair: pair[0])
    best = ranked[0][0]
    return [(value - best, solution) for value, solution in ranked]


def _screen(
    points: AvarPoints, weight: Weight, max_gm: int, price: float
) -> Iterator[tuple[float, tuple[str, ...], tuple[str, ...]]]:
    """Yield the criterion of each structure, at the best correlation times of a grid."""
    grid = time_grid(points.m)
    matrix = weight.whiten @ columns(points.m, _LAWS, [GaussMarkov.symbol] * grid.size, grid)
    matrix = matrix / np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    target = weight.whiten @ points.avar
    # A ridge far below what tells models apart keeps equal columns from being singular.
    gram = matrix.T @ matrix + 1e-12 * np.eye(matrix.shape[1])
    moment, total = matrix.T @ target, float(target @ target)
    for count in range(max_gm + 1):
        places = np.array(list(combinations(range(len(_LAWS), matrix.shape[1]), count)), dtype=np.int64)
        for size in range(len(_LAWS) + 1):
            parameters = size + 2 * count
            if not 0 < parameters < points.size:
                continue
            for laws in combinations(range(len(_LAWS)), size):
                fixed = np.broadcast_to(np.array(laws, dtype=np.int64), (len(places), size))
                cost = _least_cost(gram, moment, total, np.hstack([fixed, places]))
                if np.isfinite(cost):
                    kinds = (GaussMarkov.symbol,) * count
                    yield cost + price * parameters, tuple(_LAWS[law] for law in laws), kinds


def _least_cost(gram: FloatArray, moment: FloatArray, total: float, sets: np.ndarray) -> float:
    """Return the least sum of squares over `sets` of columns, shape (s, p), with positive variances."""
    normal = gram[sets[:, :, np.newaxis], sets[:, np.newaxis, :]]
    right = moment[sets]
    solution = np.linalg.solve(normal, right[..., np.newaxis])[..., 0]
    cost = np.where(np.all(solution > 0, axis=1), total - np.einsum("ij,ij->i", solution, right), np.inf)
    return float(cost.min())


def ranked(points: AvarPoints, weight: Weight, settings: FitSettings) -> list[tuple[float, Solution]]:
    """Return the models in reach, the best first; the one model where it is given."""
    structure = settings.structure
    if structure is None:
        return choose(points, weight, criterion=settings.criterion, max_gm=settings.max_gm)
    return [(0.0, minimise(points.m, points.avar, weight, *parts_of(structure)))]


@dataclass(frozen=True, slots=True)
class CurveFit:
    """A fit: the models in reach, the chosen one at its minimum, its weight and its misfit."""

    ranking: list[tuple[float, Solution]]
    solution: Solution
    weight: Weight
    misfit: float


@dataclass(frozen=True)
class ModelSearch:
    """Finds the models in reach of `points`, with the covariance that a rough fit by `eta3` gives."""

    points: AvarPoints
    eta3: Weight
    settings: FitSettings

    @cached_property
    def _rough(self) -> tuple[CurveSpread, Solution]:
        rough = dictionary(self.points, self.eta3)
        return CurveSpread.of_solution(self.points, rough), rough

    def whole(self) -> CurveFit:
        """Return the fit of all points.

        One given model without a time has one minimum for any weight, so that its own weight follows from
        any start; where it describes the curve, the costly covariance of the rough fit is not asked for.
        """
        if self.settings.structure is not None and not parts_of(self.settings.structure)[1]:
            given = _described(self.points, ranked(self.points, self.eta3, self.settings), self.eta3)
            if given.misfit < MISFIT:
                return given
        ranking, weight, _ = self.ranking(self.points)
        return _described(self.points, ranking, weight)

    def ranking(self, points: AvarPoints) -> tuple[list[tuple[float, Solution]], Weight, float]:
        """Return the models of the last `points`, their weight and the least misfit."""
        spread, rough = self._rough
        covariance = spread.within(self.points.size - points.size).at(rough.variances)
        weight = Weight.of_covariance(covariance)
        ranking = ranked(points, weight, self.settings)
        misfit = min(goodness(points, solution, covariance).statistic for _, solution in ranking)
        return ranking, weight, misfit


def best_band(points: AvarPoints, search: ModelSearch) -> tuple[AvarPoints, CurveFit]:
    """Return the longest run of points, up to the last, that a model describes, and the fit.

    An output filter bends the curve at its first averaging times only; without those it is as good
    as ever. Where no run is described, the one with the least misfit is taken if it is far better
    than the whole curve, and the misfit is reported.
    """
    whole = search.whole()
    structure = search.settings.structure
    least = 6 if structure is None else sum(len(TERMS[s].parameters()) for s in structure) + 3
    if not whole.misfit >= _FILTERED:
        return points, whole
    best, kept_best = whole.misfit / _CURE, None
    most = min(points.size - least, points.size // 2, _MOST_DROPPED)
    for first in range(1, most + 1):
        kept = points.within(first)
        ranking, weight, misfit = search.ranking(kept)
        if misfit < best:
            best, kept_best = misfit, (kept, ranking, weight)
        if misfit < MISFIT:
            break
    if kept_best is None:
        return points, whole
    return kept_best[0], _described(*kept_best)


def _described(points: AvarPoints, ranking: list[tuple[float, Solution]], weight: Weight) -> CurveFit:
    """Return the first of the models that describes the curve with its own weight; else the first.

    The criterion ranks all models with one weight, under which a model that lacks a small term may
    win; with its own weight it then shows a misfit that the next one does not have.
    """
    fits: list[CurveFit] = []
    for place, (delta, start) in enumerate(ranking[:_CANDIDATES]):
        solution, own, covariance = _converged(points, start, weight)
        misfit = goodness(points, solution, covariance).statistic
        rest = [(d - delta, s) for d, s in ranking[place:]]
        fits.append(CurveFit(rest, solution, own, misfit))
        if not misfit >= MISFIT:
            return fits[-1]
    return fits[0]


def _converged(points: AvarPoints, solution: Solution, weight: Weight) -> tuple[Solution, Weight, FloatArray]:
    """Return the minimum with the weight of the model itself, that weight, and the covariance."""
    spread = CurveSpread.of_solution(points, solution)
    for _ in range(_STEPS):
        if np.any(np.abs(np.log(solution.times / spread.times)) > 0.2):
            spread = CurveSpread.of_solution(points, solution)
        weight = Weight.of_covariance(spread.at(solution.variances))
        before = solution
        solution = minimise(points.m, points.avar, weight, solution.laws, solution.kinds, near=solution.times)
        if np.allclose(solution.variances, before.variances, rtol=1e-3, atol=1e-12 * points.avar.max()):
            break
    return solution, weight, spread.at(solution.variances)

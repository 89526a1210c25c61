"""Which model is nearest to measured Allan variances, and how sure its numbers are.

The minimum of a weighted sum of squares. A model is linear in the variances, so for given times the
minimum is a non-negative least-squares problem, which has one solution and needs no start. Times are
searched on a grid that covers the curve and refined from its best places. The result is the same
every time.

The choice of terms. The sum of squares J with the inverse covariance as weight is chi-squared with
(points - parameters) degrees of freedom where the model is right. Models are ranked by
J + parameters * penalty, with penalty ln n (``bic``), 2 ln ln n (``hq``) or 2 (``aic``), n the number
of samples.

Intervals. With weight W and covariance V of the Allan variances y, the estimate is linear near its
solution, theta = (G'WG)^-1 G'W y, and its covariance the sandwich of V. V itself depends on the
variances: the larger the true variance, the wider the spread. An interval therefore holds the values
v with

    (estimate - v)^2 / (s(estimate) s(v)) < chi-squared quantile,

where s(v) is the standard error if v were true. Where V is proportional to v^2 this is the interval
of a logarithm; where other terms make the spread, it is Wald's; it always has an upper end.

Source: Andrews (1999), "Consistent moment selection procedures for generalized method of moments
estimation", Econometrica 67, 543: the criteria MMSC-BIC, MMSC-HQIC and MMSC-AIC.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, groupby, product

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError
from imucal.fitting.moments.points import AvarPoints, columns, is_timed, spread_of, unit_terms
from imucal.fitting.noise_fit import MISFIT, Estimate, Goodness, Interval
from imucal.fitting.settings import CRITERIA, FitSettings
from imucal.fitting.spectral.likelihood import all_structures
from imucal.frozen import frozen_alone
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import ALWAYS, TERMS, in_order, term_keys
from imucal.solvers import non_negative, root

#: Times a decade in the grid; in a coarse one.
_PER_DECADE, _COARSE = 5, 3
#: Places of the grid from which a search is refined.
_STARTS = 3
#: Step in the logarithm of a time by which the slope of a curve is taken.
_STEP = 1e-4
#: Models whose screened criterion is within so much of the best are computed in full, at most so many.
_WITHIN, _AT_MOST = 10.0, 10
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


def whitening(covariance: FloatArray) -> FloatArray:
    """Return W, shape (k, k), of which W'W is the inverse of a covariance of shape (k, k): a weight.

    The covariance is known to some 1e-3 (its lags are summed on a grid), so a nugget of 1e-6 of each variance
    changes nothing and keeps the factorisation safe. That of no noise, as of a curve that falls by many
    decades, is a DataError.
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


@frozen_alone
class Solution:
    """A model at its minimum, where the weighted sum of squares is `objective`.

    The terms are of unit variance, times in samples, in the order of `TERMS`, of one kind by rising time;
    `variances`, shape (p,), are those of each per sample.
    """

    terms: tuple[NoiseTerm, ...]
    variances: FloatArray
    objective: float

    @classmethod
    def sorted(cls, terms: Sequence[NoiseTerm], variances: FloatArray, objective: float) -> "Solution":
        """Return the solution with its terms in order."""
        symbols = list(TERMS)
        places = sorted(
            range(len(terms)), key=lambda i: (symbols.index(terms[i].symbol), terms[i].values[1:])
        )
        return cls(
            terms=tuple(terms[i] for i in places),
            variances=variances[np.array(places, dtype=np.int64)],
            objective=objective,
        )

    @property
    def symbols(self) -> tuple[str, ...]:
        """Symbols of the terms."""
        return tuple(term.symbol for term in self.terms)

    @property
    def times(self) -> FloatArray:
        """Times of the terms that have one, in samples."""
        return np.array([time for term in self.terms for time in term.values[1:]])

    @property
    def parameters(self) -> int:
        """Number of free parameters."""
        return len(self.terms) + self.times.size

    def avar(self, m: IntArray) -> FloatArray:
        """Return the model's Allan variance, shape (k,)."""
        return columns(m, self.terms) @ self.variances

    def model(self, points: AvarPoints) -> NoiseModel:
        """Return the model in SI."""
        terms = (
            term.of(points.coefficient(term.symbol, own), *(time * points.tau0 for time in term.values[1:]))
            for term, own in zip(self.terms, self.variances.tolist(), strict=True)
        )
        return NoiseModel(terms=tuple(terms))


def time_grid(m: IntArray, per_decade: int = _PER_DECADE) -> FloatArray:
    """Return times in samples that the Allan variances at `m` can tell, shape (g,)."""
    low, high = 0.7 * float(m[0]), 1.5 * float(m[-1])
    return np.geomspace(low, high, max(2, int(np.ceil(per_decade * np.log10(high / low)))))


@frozen_alone
class Grid:
    """All terms that a curve can be fitted by, g of unit variance: those with a time at each of many.

    `columns`, shape (k, g), and `target`, shape (k,), are their Allan variances at the points, and the
    points' own, times the weight; `places` the indices of each symbol's terms, by rising time.
    """

    terms: tuple[NoiseTerm, ...]
    columns: FloatArray
    target: FloatArray
    places: dict[str, range]

    @classmethod
    def of(cls, points: AvarPoints, weight: FloatArray, per_decade: int = _PER_DECADE) -> "Grid":
        """Return the grid of all terms; `weight` as `whitening` gives it, shape (k, k)."""
        times = time_grid(points.m, per_decade)
        terms: list[NoiseTerm] = []
        places = {}
        for symbol in (symbol for symbol, term in TERMS.items() if "gmwm" in term.fitted_by):
            own = unit_terms([symbol] * times.size, times) if is_timed(symbol) else unit_terms([symbol])
            places[symbol] = range(len(terms), len(terms) + len(own))
            terms += own
        design, target = weight @ columns(points.m, terms), weight @ points.avar
        return cls(terms=tuple(terms), columns=design, target=target, places=places)

    def sets(self, symbols: Sequence[str]) -> IntArray:
        """Return every choice of a term for each of sorted symbols, shape (s, p); of one kind times rise."""
        each = [combinations(self.places[symbol], len(list(own))) for symbol, own in groupby(symbols)]
        chosen = [tuple(chain.from_iterable(parts)) for parts in product(*each)]
        return np.array(chosen, dtype=np.int64).reshape(len(chosen), len(symbols))


def minimise(
    points: AvarPoints, weight: FloatArray, symbols: Sequence[str], *, near: FloatArray | None = None
) -> Solution:
    """Return the global minimum over the variances and times of terms.

    `weight` is that of the sum of squares, as `whitening` gives it, shape (k, k). With `near`, the times of a
    minimum with another weight, one for each term that has one, they and the best place of the grid are
    refined instead of the best few.

    Source: Golub & Pereyra (1973), SIAM J. Numer. Anal. 10, 413: the linear parameters are eliminated from
    the residuals.
    """
    symbols = in_order(symbols)
    timed = np.array([is_timed(symbol) for symbol in symbols], dtype=bool)
    target = weight @ points.avar

    def solved(times: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        matrix = weight @ columns(points.m, unit_terms(symbols, times))
        variances, objective = non_negative(matrix, target)
        return target - matrix @ variances, variances, objective

    times = np.zeros(0)
    if timed.any():
        grid = Grid.of(points, weight, _PER_DECADE if timed.sum() <= 2 else _COARSE)
        sets = grid.sets(symbols)
        costs = [non_negative(grid.columns[:, chosen], target)[1] for chosen in sets]
        order = np.argsort(costs, kind="stable")[: _STARTS * int(timed.sum())]
        starts = [np.array([grid.terms[place].values[1] for place in sets[i, timed]]) for i in order]
        if near is not None:
            starts = [near, starts[0]]
        ends = time_grid(points.m)[[0, -1]]
        low, high = float(np.log(ends[0])) - 1, float(np.log(ends[1])) + 1
        found = [
            scipy.optimize.least_squares(
                *(lambda logs: solved(np.exp(logs))[0], np.clip(np.log(start), low + 1e-6, high - 1e-6)),
                bounds=(low, high),
                xtol=1e-8,
                ftol=1e-12,
                gtol=1e-12,
            )
            for start in starts
        ]
        times = np.exp(np.asarray(min(found, key=lambda one: float(one.cost)).x, dtype=np.float64))
    return Solution.sorted(unit_terms(symbols, times), *solved(times)[1:])


def dictionary(points: AvarPoints, weight: FloatArray) -> Solution:
    """Return the best fit of all terms at once, those with a time at many of them.

    It describes almost any curve; the terms left at zero are dropped.
    """
    grid = Grid.of(points, weight, _COARSE)
    variances, objective = non_negative(grid.columns, grid.target)
    kept = [term for term, variance in zip(grid.terms, variances, strict=True) if variance > 0]
    return Solution.sorted(kept, variances[variances > 0], objective)


def ranked(points: AvarPoints, weight: FloatArray, settings: FitSettings) -> list[tuple[float, Solution]]:
    """Return the best models and how much worse their criterion is, the best (0) first; of a given one, that.

    All sets of terms, up to `max_gm` of each that may stand more than once, with times of a grid, are
    screened by their normal equations at once; a solution with a negative variance is one of a smaller model.
    The best are then computed with free times.
    """
    if settings.structure is not None:
        return [(0.0, minimise(points, weight, settings.structure))]
    price = CRITERIA[settings.criterion](points.n)
    screened = sorted(screen(points, weight, settings.max_gm, price), key=lambda entry: entry[0])
    near = [symbols for value, symbols in screened if value <= screened[0][0] + _WITHIN][:_AT_MOST]
    solutions = [minimise(points, weight, symbols) for symbols in near]
    values = sorted(((s.objective + price * s.parameters, s) for s in solutions), key=lambda pair: pair[0])
    return [(value - values[0][0], solution) for value, solution in values]


def screen(
    points: AvarPoints, weight: FloatArray, max_gm: int, price: float
) -> Iterator[tuple[float, tuple[str, ...]]]:
    """Yield the criterion of each set of terms, at the best times of a grid, and their symbols."""
    grid = Grid.of(points, weight)
    matrix = grid.columns / np.sqrt(np.einsum("ij,ij->j", grid.columns, grid.columns))
    # A ridge far below what tells models apart keeps equal columns from being singular.
    gram, moment = matrix.T @ matrix + 1e-12 * np.eye(len(grid.terms)), matrix.T @ grid.target
    for symbols in all_structures(max_gm, method="gmwm"):
        parameters = len(symbols) + sum(map(is_timed, symbols))
        if parameters < points.size:
            cost = least_cost(gram, moment, float(grid.target @ grid.target), grid.sets(symbols))
            if np.isfinite(cost):
                yield cost + price * parameters, symbols


def least_cost(gram: FloatArray, moment: FloatArray, total: float, sets: IntArray) -> float:
    """Return the least sum of squares over `sets` of columns, shape (s, p), with positive variances."""
    normal = gram[sets[:, :, np.newaxis], sets[:, np.newaxis, :]]
    right = moment[sets]
    solution = np.linalg.solve(normal, right[..., np.newaxis])[..., 0]
    cost = np.where(np.all(solution > 0, axis=1), total - np.einsum("ij,ij->i", solution, right), np.inf)
    return float(cost.min())


@dataclass(frozen=True, slots=True)
class CurveFit:
    """A fit: the models in reach, the chosen one at its minimum, its weight and its misfit."""

    ranking: list[tuple[float, Solution]]
    solution: Solution
    weight: FloatArray
    misfit: float


def best_band(points: AvarPoints, eta3: FloatArray, settings: FitSettings) -> tuple[AvarPoints, CurveFit]:
    """Return the longest run of points, up to the last, that a model describes, and the fit.

    An output filter bends the curve at its first averaging times only; without those it is as good
    as ever. Where no run is described, the one with the least misfit is taken if it is far better
    than the whole curve, and the misfit is reported.

    One given model without times has one minimum for any weight, so that its own weight follows from
    any start; where it describes the curve, the costly covariance of a rough fit by `eta3` is not
    asked for.
    """
    structure = settings.structure
    if structure is not None and not any(map(is_timed, structure)):
        given = described(points, ranked(points, eta3, settings))
        if given.misfit < MISFIT:
            return points, given
    rough = dictionary(points, eta3)
    covariance = spread_of(points, rough.terms).at(rough.variances)
    whole = described(points, ranked(points, whitening(covariance), settings))
    if not whole.misfit >= _FILTERED:
        return points, whole
    least = 6 if structure is None else len(structure) + sum(map(is_timed, structure)) + 3
    best, kept_best = whole.misfit / _CURE, None
    for first in range(1, min(points.size - least, points.size // 2, _MOST_DROPPED) + 1):
        kept, own = points.within(first), covariance[first:, first:]
        ranking = ranked(kept, whitening(own), settings)
        misfit = min(goodness(kept, solution, own).statistic for _, solution in ranking)
        if misfit < best:
            best, kept_best = misfit, (kept, ranking)
        if misfit < MISFIT:
            break
    return (points, whole) if kept_best is None else (kept_best[0], described(*kept_best))


def described(points: AvarPoints, ranking: list[tuple[float, Solution]]) -> CurveFit:
    """Return the first of the models that describes the curve with its own weight; else the first.

    The criterion ranks all models with one weight, under which a model that lacks a small term may
    win; with its own weight it then shows a misfit that the next one does not have.
    """
    fits: list[CurveFit] = []
    for place, (delta, start) in enumerate(ranking[:_CANDIDATES]):
        solution, own, covariance = _converged(points, start)
        misfit = goodness(points, solution, covariance).statistic
        fits.append(CurveFit([(d - delta, s) for d, s in ranking[place:]], solution, own, misfit))
        if not misfit >= MISFIT:
            return fits[-1]
    return fits[0]


def _converged(points: AvarPoints, solution: Solution) -> tuple[Solution, FloatArray, FloatArray]:
    """Return the minimum with the weight of the model itself, that weight, and the covariance."""
    times, spread = solution.times, spread_of(points, solution.terms)
    for _ in range(_STEPS):
        if np.any(np.abs(np.log(solution.times / times)) > 0.2):
            times, spread = solution.times, spread_of(points, solution.terms)
        weight = whitening(spread.at(solution.variances))
        before = solution
        solution = minimise(points, weight, solution.symbols, near=solution.times)
        if np.allclose(solution.variances, before.variances, rtol=1e-3, atol=1e-12 * points.avar.max()):
            break
    return solution, weight, spread.at(solution.variances)


def goodness(points: AvarPoints, solution: Solution, covariance: FloatArray) -> Goodness:
    """Return how well a model describes the points, whose covariance it is given.

    An Allan variance with few degrees of freedom is far from normal; its cube root is not (Wilson
    & Hilferty 1931). The sum of squares is of those, with the correlations of `covariance`.
    """
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
    p_value = float(scipy.special.chdtrc(freedom, misfit))
    # Beyond what a normal score can say, Wilson and Hilferty's own approximation goes on.
    spread = 2 / (9 * freedom)
    statistic = (
        float(-scipy.special.ndtri(p_value))
        if p_value > 1e-15
        else (np.cbrt(misfit / freedom) - 1 + spread) / spread**0.5
    )
    return Goodness(statistic=float(statistic), p_value=p_value, chi2_per_bin=misfit / freedom, tau_s=tau)


def limits(value: float, spread_at: Callable[[float], float], quantile: float) -> tuple[float, float]:
    """Return the interval of a variance, estimated as `value`; its lower end is 0 where 0 is inside.

    `spread_at` returns the standard error of the estimate if its argument were the true variance; `quantile`
    is that of chi-squared with one degree of freedom.
    """
    own = spread_at(value)

    def excess(trial: float) -> float:
        return (value - trial) ** 2 - quantile * own * spread_at(trial)

    low = root(excess, 0.0, value, tolerance=1e-6 * value) if excess(0.0) > 0 else 0.0
    high = value + np.sqrt(quantile) * own
    for _ in range(200):
        if excess(high) > 0:
            return low, root(excess, value, high, tolerance=1e-6 * high)
        high = value + 2 * (high - value)
    return low, float("inf")


def curve_estimates(
    points: AvarPoints, solution: Solution, weight: FloatArray, *, level: float
) -> tuple[tuple[Estimate, ...], tuple[str, ...], FloatArray]:
    """Return an estimate of every term of the model, and of those that every fit reports.

    A term that is not in the model gets the upper bound that it has when it is added. Beside them the
    names and the covariance of the parameters of those that are not bounded.
    """
    absent = [symbol for symbol in ALWAYS if symbol not in solution.symbols]
    variances = np.append(solution.variances, np.zeros(len(absent)))
    padded = Solution.sorted((*solution.terms, *unit_terms(absent)), variances, solution.objective)
    reader = _Reader(points, padded, weight, absent, level)
    estimates = tuple(reader.estimate(place, key) for place, key in enumerate(term_keys(padded.symbols)))
    return estimates, *reader.covariance(estimates)


class _Reader:
    """Reads estimates off a solution, in which terms that are `absent` from the model have no variance."""

    def __init__(
        self, points: AvarPoints, solution: Solution, weight: FloatArray, absent: Sequence[str], level: float
    ) -> None:
        self.points, self.solution, self.weight = points, solution, weight
        self.spread = spread_of(points, solution.terms)
        self.quantile = float(scipy.special.chdtri(1, 1 - level))
        self.design = weight @ columns(points.m, solution.terms)
        self.target = weight @ points.avar
        self.inside = np.array([symbol not in absent for symbol in solution.symbols])
        self.timed = np.array([is_timed(symbol) for symbol in solution.symbols])
        self.free = self.inside & (solution.variances > 0)
        # By the logarithms of the times, 0 for terms without one.
        ends = [
            columns(points.m, unit_terms(solution.symbols, solution.times * np.exp(step)))
            for step in (_STEP, -_STEP)
        ]
        self.slopes = weight @ (ends[0] - ends[1]) / (2 * _STEP) * solution.variances
        influence = self._influence(self.free)
        self.scatter = influence @ self.spread.at(solution.variances) @ influence.T

    def estimate(self, place: int, key: str) -> Estimate:
        """Return the estimate of one term, in SI."""
        symbol = self.solution.symbols[place]
        low, high = self._interval(place)
        to_si = self.points.coefficient
        if not (low > 0 and self.inside[place]):
            return Estimate.bounded(key, symbol, to_si(symbol, high))
        value, low, high = (to_si(symbol, end) for end in (float(self.solution.variances[place]), low, high))
        found = Estimate(key=key, symbol=symbol, status="estimated", value=value, low=low, high=high)
        if not self.timed[place]:
            return found
        # The logarithm of a time is closer to normal than itself.
        row = self.inside.size + place
        deviation = np.sqrt(self.quantile * self.scatter[row, row])
        time = float(self.solution.terms[place].values[1]) * self.points.tau0
        factor = float(np.exp(min(deviation, 50.0)))
        return replace(found, correlation_time=Interval(value=time, low=time / factor, high=time * factor))

    def covariance(self, estimates: Sequence[Estimate]) -> tuple[tuple[str, ...], FloatArray]:
        """Return names and covariance of the parameters in SI of the terms that are estimated."""
        names: list[str] = []
        rows: list[int] = []
        slopes: list[float] = []
        for place, estimate in enumerate(estimates):
            if estimate.value is None:
                continue
            own = estimate.slopes()
            names += own
            rows += [place, self.inside.size + place][: len(own)]
            # Of a variance itself, and not of its logarithm.
            first, *times = own.values()
            slopes += [first / float(self.solution.variances[place]), *times]
        covariance = self.scatter[np.ix_(rows, rows)] * np.outer(slopes, slopes)
        return tuple(names), np.asarray(covariance, dtype=np.float64)

    def _influence(self, free: BoolArray) -> FloatArray:
        """Return what each Allan variance adds to the p variances, then the logs of the times; (2p, k).

        That is nothing for those that are not `free`, shape (p,).
        """
        design = np.hstack([self.design, self.slopes]) * np.concatenate([free, free & self.timed])
        length = np.sqrt(np.einsum("ij,ij->j", design, design))
        length[length == 0] = 1.0
        # Of minimal norm, so that terms the curve can't tell apart give a wide answer, not an error.
        solve = np.linalg.pinv(design / length, rcond=1e-12) @ self.weight
        return np.asarray(solve / length[:, np.newaxis])

    def _interval(self, place: int) -> tuple[float, float]:
        """Return the limits of one variance per sample."""
        free = self.free.copy()
        free[place] = True
        if int(free.sum() + (free & self.timed).sum()) > self.points.size:
            return 0.0, float("inf")
        value = float(self.solution.variances[place])
        if not self.inside[place]:
            used = self.inside.copy()
            used[place] = True
            value = float(non_negative(self.design[:, used], self.target)[0][used[:place].sum()])
        own, others = self._influence(free)[place], self.inside.copy()
        others[place] = False

        def spread_at(trial: float) -> float:
            """Return the standard error beside the variances that are best with this one held at `trial`."""
            at = np.zeros(self.inside.size)
            if others.any():
                rest = self.target - trial * self.design[:, place]
                at[others] = non_negative(self.design[:, others], rest)[0]
            at[place] = trial
            return float(np.sqrt(own @ self.spread.at(at) @ own))

        return limits(value, spread_at, self.quantile)

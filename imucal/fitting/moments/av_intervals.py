"""Estimates with intervals, covariance and misfit of a model that was fitted to Allan variances.

With weight W and covariance V of the Allan variances y, the estimate is linear near its solution,
theta = (G'WG)^-1 G'W y, and its covariance the sandwich of V. V itself depends on the variances:
the larger the true variance, the wider the spread. An interval therefore holds the values v with

    (estimate - v)^2 / (s(estimate) s(v)) < chi-squared quantile,

where s(v) is the standard error if v were true. Where V is proportional to v^2 this is the interval
of a logarithm; where other terms make the spread, it is Wald's; it always has an upper end.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.moments.av_covariance import AvarCovariance, avar_covariance
from imucal.fitting.moments.av_points import AvarPoints, columns, processes
from imucal.fitting.moments.av_search import Solution, Weight
from imucal.fitting.noise_fit import Estimate, Goodness, Interval
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS, in_order, term_keys
from imucal.solvers import non_negative, root

_ORDER = "QNBKR"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurveSpread:
    """The covariance of the Allan variances of a curve, for any variances of a set of terms."""

    points: AvarPoints
    laws: str
    times: FloatArray
    gaussian: AvarCovariance

    @classmethod
    def of_terms(cls, points: AvarPoints, laws: str, times: FloatArray) -> "CurveSpread":
        """Return it for the laws and the correlation times (in samples) of a model."""
        gaussian = avar_covariance(points.m, points.n, processes(laws, times), overlapping=points.overlapping)
        return cls(points=points, laws=laws, times=times, gaussian=gaussian)

    def within(self, first: int) -> "CurveSpread":
        """Return it for the points from index `first` on."""
        return replace(self, points=self.points.within(first), gaussian=self.gaussian.within(first))

    def at(self, variances: FloatArray) -> FloatArray:
        """Return the covariance, shape (k, k), at variances in the order of `columns`.

        White noise of excess kurtosis g adds g avar_i avar_j / n, avar its own Allan variance:
        each Allan variance is a mean of squares in which every sample weighs the same.
        """
        ramp = self.laws.find("R")
        random = variances if ramp < 0 else np.delete(variances, ramp)
        covariance = self.gaussian.at(random, float(variances[ramp]) if ramp >= 0 else 0.0)
        if self.points.excess and "N" in self.laws:
            white = float(variances[self.laws.index("N")]) / self.points.m
            covariance = covariance + self.points.excess * np.outer(white, white) / self.points.n
        return covariance


def derivatives(solution: Solution, points: AvarPoints, free: np.ndarray) -> FloatArray:
    """Return the derivatives of the model by its free variances and log correlation times."""
    step = 1e-4
    plain = columns(points.m, solution.laws, solution.times)[:, free]
    count = solution.times.size
    if count == 0:
        return plain
    later = columns(points.m, "", solution.times * np.exp(step))
    sooner = columns(points.m, "", solution.times * np.exp(-step))
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
    times = zip(solution.variances[count:], solution.times, strict=True)
    terms += [points.term("GM", float(v), float(time)) for v, time in times]
    return NoiseModel(terms=tuple(sorted(terms, key=lambda term: list(TERMS).index(term.symbol))))


def curve_estimates(
    points: AvarPoints, solution: Solution, weight: Weight, *, level: float
) -> CurveEstimates:
    """Return an estimate of every term of the model, and of N, B and K.

    A term that is not in the model gets the upper bound that it has when it is added.
    """
    laws = "".join(law for law in _ORDER if law in solution.laws or law in ALWAYS)
    spread = CurveSpread.of_terms(points, laws, solution.times)
    reader = _Reader(spread, weight, _padded(solution, laws), solution.laws, level)
    symbols = in_order([*laws, *["GM"] * solution.times.size])
    gauss_markov = count(len(laws))
    places = [next(gauss_markov) if s == "GM" else laws.index(s) for s in symbols]
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


def _padded(solution: Solution, laws: str) -> Solution:
    """Return the solution with the laws it lacks, at variance 0."""
    given = dict(zip(solution.laws, solution.variances, strict=False))
    variances = [given.get(law, 0.0) for law in laws]
    return replace(
        solution, laws=laws, variances=np.append(variances, solution.variances[len(solution.laws) :])
    )


class _Reader:
    """Reads estimates off a solution; `own` are the laws of the model itself."""

    def __init__(
        self, spread: CurveSpread, weight: Weight, solution: Solution, own: str, level: float
    ) -> None:
        from scipy.special import chdtri

        self.points, self.spread, self.weight, self.solution = spread.points, spread, weight, solution
        self.quantile = float(chdtri(1, 1 - level))
        self.design = weight.whiten @ columns(self.points.m, solution.laws, solution.times)
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
            correlation_time=self._time(place - self.count) if symbol == "GM" else None,
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

"""Estimates with intervals, in SI, of a model that was fitted to Allan variances."""

from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.moments.av_intervals import CurveSpread, Spread, limits
from imucal.fitting.moments.av_points import AvarPoints, columns
from imucal.fitting.moments.av_search import Solution, Weight, non_negative
from imucal.fitting.noise_fit import Estimate, Interval
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS, term_keys

_ORDER = "QNBKR"


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
    spread = Spread(curve=CurveSpread.of_terms(points, laws, solution.times), weight=weight)
    reader = _Reader(points, spread, _padded(solution, laws), solution.laws, level)
    symbols = sorted([*laws, *["GM"] * solution.times.size], key=list(TERMS).index)
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
        curve_covariance=spread.curve.at(reader.solution.variances),
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
        self, points: AvarPoints, spread: Spread, solution: Solution, own: str, level: float
    ) -> None:
        from scipy.special import chdtri

        self.points, self.spread, self.solution, self.level = points, spread, solution, level
        self.quantile = float(chdtri(1, 1 - level))
        self.design = spread.weight.whiten @ columns(points.m, solution.laws, solution.times)
        self.target = spread.weight.whiten @ points.avar
        count = len(solution.laws)
        self.inside = np.array([law in own for law in solution.laws] + [True] * solution.times.size)
        self.free = self.inside & (solution.variances > 0)
        self.count = count

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

    def _time(self, index: int) -> Interval:
        """Return the correlation time in s; its logarithm is closer to normal than itself."""
        covariance = self.spread.covariance(self.solution, self.solution.variances, self.free)
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
        row = int(free[:place].sum())

        def spread_at(trial: float) -> float:
            at = self._others(place, trial)
            variance = self.spread.covariance(self.solution, at, free)[row, row]
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
        raw = self.spread.covariance(self.solution, self.solution.variances, self.free)
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

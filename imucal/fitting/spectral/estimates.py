"""Maximum of the likelihood -> estimates in SI, with their intervals and covariance."""

from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Estimate, Goodness, Interval
from imucal.fitting.spectral.intervals import RAMP, profile_limits, quantile, student_quantile
from imucal.fitting.spectral.likelihood import Candidates
from imucal.fitting.spectral.ordinates import MARKOV, Ordinates
from imucal.fitting.spectral.scoring import Maximum, covariance, misfit_factors
from imucal.fitting.spectral.structures import Structure, parameter_columns
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS, in_order, term_keys

#: Misfit score from which the model does not describe the record.
MISFIT = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """One candidate at its maximum; candidates and maximum have a single row."""

    structure: Structure
    candidate: Candidates
    maximum: Maximum

    def by_time(self) -> "Fitted":
        """Return the same with its Gauss-Markov terms by rising correlation time."""
        count, room = self.structure.count("GM"), self.candidate.room_markov
        if count < 2:
            return self
        order = np.argsort(self.maximum.theta[0, MARKOV + room : MARKOV + room + count])
        index = np.arange(self.candidate.width)
        index[MARKOV : MARKOV + count] = MARKOV + order
        index[MARKOV + room : MARKOV + room + count] = MARKOV + room + order
        old = self.maximum
        information = old.information[:, index][:, :, index]
        return replace(self, maximum=replace(old, theta=old.theta[:, index], information=information))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """What every estimate of a fit is made with.

    Attributes
    ----------
    ordinates
        What is fitted.
    level
        Confidence level.
    shortest
        Shortest correlation time, in samples.
    common
        Regressors in every model.
    unit
        U per scaled unit.
    tau0
        Sampling period, in s.
    widening
        Symbol -> factor by which its interval is wider than the likelihood says.
    """

    ordinates: Ordinates
    level: float
    shortest: float
    common: tuple[str, ...]
    unit: float
    tau0: float
    widening: dict[str, float]

    def deviation(self, symbol: str) -> float:
        """Return the coefficient, in SI, of a unit deviation per sample."""
        return self.unit / TERMS[symbol].per_sample(self.tau0)

    def limits(self, fitted: "Fitted", columns: list[int]) -> tuple[FloatArray, FloatArray]:
        """Return the limits of some parameters of a fit, shape (k,) each; see `profile_limits`."""
        rows, places = np.zeros(len(columns), dtype=np.int64), np.array(columns)
        reach = np.full(places.size, quantile(self.level))
        variances = (places >= 0) & (places < MARKOV + fitted.candidate.room_markov)
        inverse = covariance(fitted.maximum.information[0], fitted.candidate.free[0])
        deviation = np.sqrt(np.diag(inverse)[places[variances]])
        reach[variances] = student_quantile(self.level, deviation)
        return profile_limits(
            self.ordinates,
            fitted.candidate.take(rows),
            fitted.maximum.take(rows),
            places,
            reach=reach,
            shortest=self.shortest,
        )


def estimate(problem: Problem, fitted: Fitted) -> tuple[Estimate, ...]:
    """Return an estimate of each term of a fitted structure; those whose interval holds 0 bounded."""
    columns = parameter_columns(fitted.structure, fitted.candidate.room_markov)
    if "R" in fitted.structure:
        columns.append(("R", RAMP))
    lows, highs = problem.limits(fitted, [column for _, column in columns])
    found = fitted.maximum
    values = [found.beta[0, 0] if name == "R" else found.theta[0, column] for name, column in columns]
    table = {
        name: (float(value), float(low), float(high))
        for (name, _), value, low, high in zip(columns, values, lows, highs, strict=True)
    }
    keys = term_keys(fitted.structure)
    return tuple(_term(problem, key, s, table) for key, s in zip(keys, fitted.structure, strict=True))


def _term(problem: Problem, key: str, symbol: str, table: dict[str, tuple[float, float, float]]) -> Estimate:
    unit = problem.deviation(symbol)
    if symbol == "R":
        value, low, high = (unit * x for x in table[key])
        if low <= 0 <= high:
            return Estimate.bounded(key, symbol, max(-low, high))
        ends = sorted((abs(low), abs(high)))
        return Estimate(
            key=key, symbol=symbol, status="estimated", value=abs(value), low=ends[0], high=ends[1]
        )
    value, low, high = table[TERMS[symbol].parameter_names(key)[0]]
    widening = problem.widening.get(symbol, 1.0)
    high = value + widening * (high - value)
    if np.isneginf(low):
        return Estimate.bounded(key, symbol, float(unit * np.exp(high / 2)))
    low = value - widening * (value - low)
    ends = [float(unit * np.exp(x / 2)) for x in (value, low, high)]
    time = _time(table[f"{key}.T"], problem.tau0) if symbol == "GM" else None
    return Estimate(
        key=key,
        symbol=symbol,
        status="estimated",
        value=ends[0],
        low=ends[1],
        high=ends[2],
        correlation_time=time,
    )


def _time(logs: tuple[float, float, float], tau0: float) -> Interval:
    value, low, high = (tau0 * float(np.exp(x)) for x in logs)
    return Interval(value=value, low=low, high=high)


def covariance_of(
    problem: Problem, fitted: Fitted, estimates: tuple[Estimate, ...]
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of the parameters and their covariance in SI, from the expected information."""
    known = {e.key: e for e in estimates if e.value is not None}
    every = parameter_columns(fitted.structure, fitted.candidate.room_markov)
    columns = [(name, column) for name, column in every if name.partition(".")[0] in known]
    places = [column for _, column in columns]
    inverse = covariance(fitted.maximum.information[0], fitted.candidate.free[0])
    names = [name for name, _ in columns]
    slope = np.array([_slope(name, known) * problem.widening.get(name, 1.0) for name in names])
    matrix = inverse[np.ix_(places, places)] * np.outer(slope, slope)
    if "R" in known:
        names.append("R")
        variance = float(fitted.maximum.beta_covariance[0, 0, 0]) * problem.deviation("R") ** 2
        matrix = np.block(
            [[matrix, np.zeros((len(columns), 1))], [np.zeros((1, len(columns))), np.array([[variance]])]]
        )
    return tuple(names), matrix


def _slope(name: str, known: dict[str, Estimate]) -> float:
    """Return the derivative of a coefficient in the parameter: log variance or log time."""
    key, _, part = name.partition(".")
    found = known[key]
    if part == "T" and found.correlation_time is not None:
        return found.correlation_time.value
    return 0.5 * float(found.value or 0.0)


def misfits_of(problem: Problem, fitted: Fitted, found: Goodness) -> dict[str, float]:
    """Return for each symbol by what factor a misfit makes its interval wider, one at least; {} for none."""
    if found.statistic < MISFIT:
        return {}
    factors = misfit_factors(problem.ordinates, fitted.candidate, fitted.maximum.theta)
    missing = [symbol for symbol in ALWAYS if symbol not in fitted.structure]
    columns = parameter_columns(in_order((*fitted.structure, *missing)), fitted.candidate.room_markov)
    largest: dict[str, float] = {}
    for name, column in columns:
        if column < factors.size:
            symbol = name.partition(".")[0].rstrip("0123456789")
            largest[symbol] = max(largest.get(symbol, 1.0), float(factors[column]))
    return largest


def model_of(problem: Problem, fitted: Fitted, estimates: tuple[Estimate, ...]) -> NoiseModel:
    """Return the model of the estimated terms; the estimate of a ramp is its size, the model has its sign."""
    ramp = float(fitted.maximum.beta[0, 0]) * problem.deviation("R")
    return NoiseModel(
        terms=tuple(
            TERMS[found.symbol].of(
                ramp if found.symbol == "R" else found.value,
                *([found.correlation_time.value] if found.correlation_time else []),
            )
            for found in estimates
            if found.value is not None
        )
    )

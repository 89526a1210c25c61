"""Maximum of the likelihood -> estimates in SI, with their intervals and covariance."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Estimate, Interval
from imucal.fitting.spectral.intervals import RAMP, profile_limits
from imucal.fitting.spectral.likelihood import Candidates
from imucal.fitting.spectral.ordinates import LAWS, MARKOV, Ordinates
from imucal.fitting.spectral.scoring import Maximum, bounds, covariance, maximize
from imucal.fitting.spectral.structures import Structure, candidates_of, parameter_columns
from imucal.noise.model import NoiseModel
from imucal.noise.terms import TERMS, in_order, term_keys

_COLUMN = {law.value: index for index, law in enumerate(LAWS)}


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
        sorted_maximum = Maximum(
            theta=old.theta[:, index],
            objective=old.objective,
            information=old.information[:, index][:, :, index],
            beta=old.beta,
            beta_covariance=old.beta_covariance,
            converged=old.converged,
        )
        return Fitted(structure=self.structure, candidate=self.candidate, maximum=sorted_maximum)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scales:
    """From scaled units back to SI.

    Attributes
    ----------
    unit
        U per scaled unit.
    tau0
        Sampling period, in s.
    widening
        Symbol -> factor by which its interval is wider than the likelihood says.
    """

    unit: float
    tau0: float
    widening: dict[str, float]

    def deviation(self, symbol: str) -> float:
        """Return the coefficient, in SI, of a unit deviation per sample."""
        return self.unit / TERMS[symbol].per_sample(self.tau0)


def estimate(
    ordinates: Ordinates, fitted: Fitted, scales: Scales, *, level: float, shortest: float
) -> tuple[Estimate, ...]:
    """Return an estimate of each term of a fitted structure; those whose interval holds 0 bounded."""
    columns = parameter_columns(fitted.structure, fitted.candidate.room_markov)
    if "R" in fitted.structure:
        columns.append(("R", RAMP))
    rows = np.zeros(len(columns), dtype=np.int64)
    limits = profile_limits(
        ordinates,
        fitted.candidate.take(rows),
        fitted.maximum.take(rows),
        np.array([column for _, column in columns]),
        level=level,
        shortest=shortest,
    )
    table = {}
    for (name, column), low, high in zip(columns, limits.low, limits.high, strict=True):
        if name == "R":
            table[name] = (float(fitted.maximum.beta[0, 0]), float(low), float(high))
        else:
            table[name] = (float(fitted.maximum.theta[0, column]), float(low), float(high))
    return tuple(_term(key, symbol, table, scales) for key, symbol in _keys(fitted.structure))


def _keys(structure: Structure) -> list[tuple[str, str]]:
    return list(zip(term_keys(structure), structure, strict=True))


def _term(key: str, symbol: str, table: dict[str, tuple[float, float, float]], scales: Scales) -> Estimate:
    unit = scales.deviation(symbol)
    if symbol == "R":
        value, low, high = (unit * x for x in table[key])
        if low <= 0 <= high:
            return _bounded(key, symbol, max(-low, high))
        ends = sorted((abs(low), abs(high)))
        return Estimate(
            key=key, symbol=symbol, status="estimated", value=abs(value), low=ends[0], high=ends[1]
        )
    value, low, high = table[TERMS[symbol].parameter_names(key)[0]]
    widening = scales.widening.get(symbol, 1.0)
    high = value + widening * (high - value)
    if np.isneginf(low):
        return _bounded(key, symbol, float(unit * np.exp(high / 2)))
    low = value - widening * (value - low)
    ends = [float(unit * np.exp(x / 2)) for x in (value, low, high)]
    time = _time(table[f"{key}.T"], scales) if symbol == "GM" else None
    return Estimate(
        key=key,
        symbol=symbol,
        status="estimated",
        value=ends[0],
        low=ends[1],
        high=ends[2],
        correlation_time=time,
    )


def _bounded(key: str, symbol: str, high: float) -> Estimate:
    return Estimate(key=key, symbol=symbol, status="bounded", value=None, low=0.0, high=high)


def _time(logs: tuple[float, float, float], scales: Scales) -> Interval:
    value, low, high = (scales.tau0 * float(np.exp(x)) for x in logs)
    return Interval(value=value, low=low, high=high)


def drop_terms(
    ordinates: Ordinates, fitted: Fitted, keys: list[str], *, shortest: float, common: tuple[str, ...]
) -> Fitted:
    """Return the fit of the structure without some of its terms, started where it stands."""
    kept = [(key, symbol) for key, symbol in _keys(fitted.structure) if key not in keys]
    structure = tuple(symbol for _, symbol in kept)
    candidate = _like(fitted, structure, ordinates, common, structure.count("GM"))
    start = np.zeros((1, candidate.width))
    start[0, :MARKOV] = fitted.maximum.theta[0, :MARKOV]
    old_room, room = fitted.candidate.room_markov, candidate.room_markov
    places = [i for i, (key, _) in enumerate(_markov(fitted.structure)) if key not in keys]
    for new, old in enumerate(places):
        start[0, MARKOV + new] = fitted.maximum.theta[0, MARKOV + old]
        start[0, MARKOV + room + new] = fitted.maximum.theta[0, MARKOV + old_room + old]
    start[0, MARKOV + 2 * room :] = fitted.maximum.theta[0, MARKOV + 2 * old_room :]
    maximum = maximize(ordinates, candidate, start, shortest=shortest)
    return Fitted(structure=structure, candidate=candidate, maximum=maximum)


def _markov(structure: Structure) -> list[tuple[str, str]]:
    return [(key, symbol) for key, symbol in _keys(structure) if symbol == "GM"]


def _like(
    fitted: Fitted, structure: Structure, ordinates: Ordinates, common: tuple[str, ...], room: int
) -> Candidates:
    """Return the candidate of another structure behind the same output filter."""
    return candidates_of(
        [structure],
        ordinates.names,
        poles=int(fitted.candidate.poles[0]),
        zeros=int(fitted.candidate.zeros[0]),
        common=common,
        room_markov=room,
    )


def add_term(
    ordinates: Ordinates, fitted: Fitted, symbol: str, *, shortest: float, common: tuple[str, ...]
) -> Fitted:
    """Return the fit with a power-law term added, started from almost none of it."""
    structure = in_order((*fitted.structure, symbol))
    candidate = _like(fitted, structure, ordinates, common, fitted.candidate.room_markov)
    low, _ = bounds(ordinates, candidate)
    column = _COLUMN[symbol]
    starts = np.repeat(fitted.maximum.theta, 2, axis=0)
    starts[:, column] = low[column] + np.array([8.0, 16.0])
    found = maximize(ordinates, candidate.take(np.zeros(2, dtype=np.int64)), starts, shortest=shortest)
    best = np.array([int(np.argmin(found.objective))])
    return Fitted(structure=structure, candidate=candidate, maximum=found.take(best))


def upper_bound(
    ordinates: Ordinates, fitted: Fitted, symbol: str, scales: Scales, *, level: float, shortest: float
) -> tuple[Estimate, float]:
    """Return the bound of a power-law term that was added, and the lower limit of its deviation."""
    limits = profile_limits(
        ordinates,
        fitted.candidate,
        fitted.maximum,
        np.array([_COLUMN[symbol]]),
        level=level,
        shortest=shortest,
    )
    unit = scales.deviation(symbol)
    value = float(fitted.maximum.theta[0, _COLUMN[symbol]])
    high = value + scales.widening.get(symbol, 1.0) * (float(limits.high[0]) - value)
    return _bounded(symbol, symbol, unit * float(np.exp(high / 2))), float(np.exp(limits.low[0] / 2)) * unit


def covariance_of(
    fitted: Fitted, estimates: tuple[Estimate, ...], scales: Scales
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of the parameters and their covariance in SI, from the expected information."""
    known = {e.key: e for e in estimates if e.value is not None}
    every = parameter_columns(fitted.structure, fitted.candidate.room_markov)
    columns = [(name, column) for name, column in every if name.partition(".")[0] in known]
    places = [column for _, column in columns]
    inverse = covariance(fitted.maximum.information[0], fitted.candidate.free[0])
    names = [name for name, _ in columns]
    slope = np.array([_slope(name, known) for name in names])
    widen = np.array([scales.widening.get(name, 1.0) for name in names])
    slope = slope * widen
    matrix = inverse[np.ix_(places, places)] * np.outer(slope, slope)
    if "R" in known:
        names.append("R")
        variance = float(fitted.maximum.beta_covariance[0, 0, 0]) * scales.deviation("R") ** 2
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


def model_of(estimates: tuple[Estimate, ...], fitted: Fitted, scales: Scales) -> NoiseModel:
    """Return the model of the estimated terms; the estimate of a ramp is its size, the model has its sign."""
    ramp = float(fitted.maximum.beta[0, 0]) * scales.deviation("R")
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

"""Whether records of one sensor have the same coefficients: the likelihood ratio of one against one each.

A term is tested with the other terms free in each record, so that a change of one is not blamed on
another; correlation times and the output filter are as in the joint fit.

Source: Wilks (1938), Annals of Mathematical Statistics 9, 60.
"""

from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.bin_fit import BinFit
from imucal.fitting.spectral.estimates import Problem
from imucal.fitting.spectral.ordinates import MARKOV, Ordinates
from imucal.fitting.spectral.scoring import Maximum, bounds, covariance, maximize
from imucal.fitting.spectral.structures import parameter_columns

#: Deviations at which the profile is looked at, from the smallest record's to the largest's; and how often
#: the range is narrowed to the best and its neighbours.
_PLACES, _ROUNDS = 9, 3
#: Where a record's fit starts besides at the joint one: terms so far above invisible, in log variance.
_RAISED = (8.0, 16.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordTest:
    """The test of one term over r records.

    Attributes
    ----------
    key, symbol
        Of the term.
    statistic, dof, p_value
        Twice the drop of the log-likelihood with one coefficient for all records; chi-squared with
        r - 1 degrees of freedom where there is one; the probability of so much by chance.
    values
        The coefficient of each record, in SI, shape (r,); 0 where its data want none.
    log_deviations
        Standard error of the logarithm of each, shape (r,); inf where it is not told.
    """

    key: str
    symbol: str
    statistic: float
    dof: int
    p_value: float
    values: FloatArray
    log_deviations: FloatArray


def record_tests(fit: BinFit) -> tuple[RecordTest, ...]:
    """Return the test of each term of a joint fit but the ramp; none for a single record."""
    if len(fit.records) < 2:
        return ()
    records = [_Record(one, fit) for one in fit.records]
    room = fit.whole.candidate.room_markov
    terms = [
        (name.partition(".")[0], column)
        for name, column in parameter_columns(fit.whole.structure, room)
        if column < MARKOV + room
    ]
    columns = np.array([column for _, column in terms])
    peaks = np.array([record.deviations(columns) for record in records])
    errors = np.array([record.log_deviations(columns) for record in records])
    drops = _least(records, columns, peaks) - sum(record.objective for record in records)
    return tuple(
        _test(fit.problem, key, *of_term)
        for (key, _), *of_term in zip(terms, drops.tolist(), peaks.T, errors.T, strict=True)
    )


def _test(problem: Problem, key: str, drop: float, peaks: FloatArray, errors: FloatArray) -> RecordTest:
    from scipy.special import chdtrc

    symbol = key.rstrip("0123456789")
    surplus = problem.widening.get(symbol, 1.0) ** 2
    statistic = max(2 * drop / surplus, 0.0)
    return RecordTest(
        key=key,
        symbol=symbol,
        statistic=statistic,
        dof=peaks.size - 1,
        p_value=float(chdtrc(peaks.size - 1, statistic)),
        values=problem.deviation(symbol) * peaks,
        log_deviations=np.sqrt(surplus) * errors,
    )


def _least(records: "list[_Record]", columns: IntArray, peaks: FloatArray) -> FloatArray:
    """Return the least -log L of all records with one deviation of a term, shape (t,) for t columns.

    `peaks` are the deviations in each record by itself, shape (r, t). All terms are searched side by side.
    """
    term = np.arange(columns.size)
    places = np.linspace(peaks.min(axis=0), peaks.max(axis=0), _PLACES, axis=1)
    profiles = [record.profile(columns, places) for record in records]
    least = np.full(columns.size, np.inf)
    for left in reversed(range(_ROUNDS)):
        total = np.sum([profile.objective for profile in profiles], axis=0).reshape(places.shape)
        least = np.minimum(least, total.min(axis=1))
        if left:
            best = np.argmin(total, axis=1)
            ends = [np.maximum(best - 1, 0), np.minimum(best + 1, _PLACES - 1)]
            first, last = (places[term, end] for end in ends)
            places = np.linspace(first, last, _PLACES, axis=1)
            rows = [term * _PLACES + end for end in ends]
            profiles = [
                record.finer(columns, places, *(profile.theta[row] for row in rows))
                for record, profile in zip(records, profiles, strict=True)
            ]
    return least


class _Record:
    """One record: its own maximum in the variances, and profiles about it."""

    def __init__(self, ordinates: Ordinates, fit: BinFit) -> None:
        self.ordinates, self.shortest = ordinates, fit.problem.shortest
        # What was taken out of another record is nothing in this one.
        own = np.einsum("iib->i", ordinates.gram) > 0
        joint = fit.whole.candidate
        self.candidate = replace(joint, regressors=joint.regressors & own)
        variances = np.arange(self.candidate.width) < MARKOV + self.candidate.room_markov
        self.free = self.candidate.free & variances
        self.low, _ = bounds(ordinates, self.candidate, shortest=self.shortest)
        start = fit.whole.maximum.theta
        raised = [np.where(self.free, np.maximum(start, self.low + more), start) for more in _RAISED]
        found = self.maximize(np.concatenate([start, *raised]), np.tile(self.free, (1 + len(raised), 1)))
        self.maximum: Maximum = found.take(np.array([int(np.argmin(found.objective))]))
        self.objective = float(self.maximum.objective[0])

    def maximize(self, starts: FloatArray, free: BoolArray) -> Maximum:
        """Return the maxima from starts, shape (k, p), in what is free in each of them."""
        rows: IntArray = np.zeros(starts.shape[0], dtype=np.int64)
        return maximize(
            self.ordinates,
            self.candidate.take(rows),
            starts,
            free=free,
            shortest=self.shortest,
            tolerance=1e-5,
        )

    def deviations(self, columns: IntArray) -> FloatArray:
        """Return the deviation of each term, shape (t,); 0 where its variance is at its lower end."""
        logs = self.maximum.theta[0, columns]
        return np.where(logs > self.low[columns] + 1e-6, np.exp(logs / 2), 0.0)

    def log_deviations(self, columns: IntArray) -> FloatArray:
        """Return the standard error of the logarithm of each coefficient, shape (t,)."""
        inverse = covariance(self.maximum.information[0], self.free[0])
        errors: FloatArray = 0.5 * np.sqrt(np.diag(inverse)[columns])
        return errors

    def profile(self, columns: IntArray, places: FloatArray) -> Maximum:
        """Return the maxima with the deviation of each term held at its places, shape (t, k)."""
        start = self.maximum.theta[0]
        # What was at its lower end in the maximum may come in where this term is held low.
        start = np.where(self.free[0] & (start < self.low + _RAISED[0]), self.low + _RAISED[1], start)
        return self._held(columns, places, np.tile(start, (places.size, 1)))

    def finer(self, columns: IntArray, places: FloatArray, first: FloatArray, last: FloatArray) -> Maximum:
        """Return the maxima as `profile`, from those at the first and the last place of each term, (t, p).

        A search starts on the line between the two, near its end; a term that is at its lower end in one of
        them starts where it is in the other one.
        """
        part = np.linspace(0, 1, places.shape[1])[:, None]
        first, last = first[:, None], last[:, None]
        there = np.minimum(first, last) > self.low + _RAISED[0]
        starts = np.where(there, (1 - part) * first + part * last, np.maximum(first, last))
        return self._held(columns, places, starts.reshape(places.size, -1))

    def _held(self, columns: IntArray, places: FloatArray, starts: FloatArray) -> Maximum:
        held = np.repeat(columns, places.shape[1])
        rows = np.arange(held.size)
        logs = 2 * np.log(np.maximum(places.ravel(), 1e-300))
        starts[rows, held] = np.maximum(logs, self.low[held])
        free = np.tile(self.free, (held.size, 1))
        free[rows, held] = False
        return self.maximize(starts, free)

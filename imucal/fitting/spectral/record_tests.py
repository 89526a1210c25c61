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
    every = parameter_columns(fit.whole.structure, room)
    return tuple(
        _test(fit.problem, records, name, column) for name, column in every if column < MARKOV + room
    )


def _test(problem: Problem, records: "list[_Record]", name: str, column: int) -> RecordTest:
    from scipy.special import chdtrc

    key = name.partition(".")[0]
    symbol = key.rstrip("0123456789")
    peaks = np.array([record.deviation_of(column) for record in records])
    free = sum(record.objective for record in records)
    least, low, high = np.inf, peaks.min(), peaks.max()
    for _ in range(_ROUNDS if high > low else 1):
        places = np.linspace(low, high, _PLACES)
        total = np.sum([record.profile(column, places) for record in records], axis=0)
        best = int(np.argmin(total))
        least = min(least, float(total[best]))
        low, high = places[max(best - 1, 0)], places[min(best + 1, _PLACES - 1)]
    surplus = problem.widening.get(symbol, 1.0) ** 2
    statistic = max(2 * (least - free) / surplus, 0.0)
    unit, errors = problem.deviation(symbol), [record.log_deviation(column) for record in records]
    return RecordTest(
        key=key,
        symbol=symbol,
        statistic=statistic,
        dof=len(records) - 1,
        p_value=float(chdtrc(len(records) - 1, statistic)),
        values=unit * peaks,
        log_deviations=np.sqrt(surplus) * np.array(errors),
    )


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
        found = self.maximize(np.concatenate([start, *raised]), self.free)
        self.maximum: Maximum = found.take(np.array([int(np.argmin(found.objective))]))
        self.objective = float(self.maximum.objective[0])

    def maximize(self, starts: FloatArray, free: BoolArray) -> Maximum:
        rows: IntArray = np.zeros(starts.shape[0], dtype=np.int64)
        return maximize(
            self.ordinates,
            self.candidate.take(rows),
            starts,
            free=free[rows],
            shortest=self.shortest,
            tolerance=1e-5,
        )

    def deviation_of(self, column: int) -> float:
        """Return the deviation of a term, 0 where its variance is at its lower end."""
        log = float(self.maximum.theta[0, column])
        return float(np.exp(log / 2)) if log > self.low[column] + 1e-6 else 0.0

    def log_deviation(self, column: int) -> float:
        """Return the standard error of the logarithm of the coefficient."""
        return 0.5 * float(np.sqrt(covariance(self.maximum.information[0], self.free[0])[column, column]))

    def profile(self, column: int, places: FloatArray) -> FloatArray:
        """Return -log L with a term's deviation held at each of `places`, shape of `places`."""
        starts = np.repeat(self.maximum.theta, places.size, axis=0)
        starts[:, column] = np.maximum(2 * np.log(np.maximum(places, 1e-300)), self.low[column])
        free = self.free.copy()
        free[0, column] = False
        # What was at its lower end in the maximum may come in where this term is held low.
        others = free[0] & (starts[0] < self.low + _RAISED[0])
        starts[:, others] = (self.low + _RAISED[1])[others]
        return self.maximize(starts, free).objective

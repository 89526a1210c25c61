"""The slow part of an axis as one first-order Gauss-Markov process, for formats that hold just one."""

import math
from dataclasses import dataclass

from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.result import AxisReport

#: Correlation time where none was measured, in s: long against the record, so that a walk stays one.
NOMINAL_TIME_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowNoise:
    """A first-order Gauss-Markov process dx/dt = -x/T + driving * w(t).

    Attributes
    ----------
    driving
        Density of the driving noise, in U/sqrt(s); sigma = driving * sqrt(T/2).
    correlation_time
        T, in s.
    number
        The K it stands for; None where it is a Gauss-Markov term of the fit.
    note
        Where it comes from.
    """

    driving: float
    correlation_time: float
    number: Number | None
    note: str

    @property
    def sigma(self) -> float:
        """Steady-state standard deviation, in U."""
        return self.driving * math.sqrt(self.correlation_time / 2)


def slow_noise(numbers: Numbers, axis: AxisReport) -> SlowNoise:
    """Return the process that best stands for what is slower than white noise.

    A random walk that was found wins, with a nominal T: it goes on at the longest times, and a
    short T would stop it. Else the slowest Gauss-Markov term, with its own T. Else the bound on K.
    """
    term = numbers.gauss_markov(axis)
    if term is not None and axis.fit["K"].value is None:
        sigma, time = term
        return SlowNoise(
            driving=sigma * math.sqrt(2 / time),
            correlation_time=time,
            number=None,
            note=f"Gauss-Markov term of {axis.name}: sigma {sigma:.4g}, T {time:.4g} s",
        )
    walk = numbers.of(axis, "K")
    note = f"{walk.note}; T is nominal"
    return SlowNoise(driving=walk.value, correlation_time=NOMINAL_TIME_S, number=walk, note=note)

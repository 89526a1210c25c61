"""Segments: what each part of a record says of its noise, as values."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, read_only

#: Chance that a term of a stationary record is found to change.
CHANCE = 0.01
#: Symbols of the slow terms. What changes slowly is one thing in a segment: which of them it was that
#: changed is not told.
SLOW = frozenset({"B", "GM", "K", "R"})


@dataclass(frozen=True, slots=True, kw_only=True)
class TermHomogeneity:
    """How much a term changes from segment to segment.

    Attributes
    ----------
    key, symbol
        Of the term, as in its estimate.
    statistic, dof
        Q, which is chi-squared with `dof` degrees of freedom where the term is the same in all segments.
    p_value
        Probability of so large a Q by chance.
    spread
        Relative standard deviation of the coefficient between segments, beyond what chance gives.
    factor
        Birge ratio sqrt(Q/dof); 1 where chance explains Q.
    highest_s, lowest_s
        Start and end of the segments where it is largest and smallest, in s from the first sample.
    """

    key: str
    symbol: str
    statistic: float
    dof: int
    p_value: float
    spread: float
    factor: float
    highest_s: tuple[float, float]
    lowest_s: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trace:
    """A quantity in each segment: value and limits, shape (s,) each, in SI."""

    value: FloatArray
    low: FloatArray
    high: FloatArray

    def __post_init__(self) -> None:
        for name in ("value", "low", "high"):
            object.__setattr__(self, name, read_only(np.asarray(getattr(self, name), dtype=np.float64)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segments:
    """What the segments of a record say of its noise.

    Attributes
    ----------
    start_s, end_s
        When each begins and ends, shape (s,), in s from the first sample.
    white
        N in each segment; None where the fit has no N.
    floor
        Allan deviation of the model in each segment at `floor_tau_s`, the curve's minimum or a quarter of a
        segment; None where the fit has no slow noise.
    floor_tau_s
        In s; NaN without a floor.
    terms
        One for each term that was tested.
    """

    start_s: FloatArray
    end_s: FloatArray
    white: Trace | None
    floor: Trace | None
    floor_tau_s: float
    terms: tuple[TermHomogeneity, ...]

    def __post_init__(self) -> None:
        for name in ("start_s", "end_s"):
            object.__setattr__(self, name, read_only(np.asarray(getattr(self, name), dtype=np.float64)))

    def __getitem__(self, key: str) -> TermHomogeneity:
        for term in self.terms:
            if term.key == key:
                return term
        found = ", ".join(term.key for term in self.terms)
        msg = f"{key!r}; the segments tell {found}"
        raise KeyError(msg)

    @property
    def changing(self) -> tuple[TermHomogeneity, ...]:
        """The terms that change by more than chance, the one that changes most surely first."""
        return tuple(sorted((t for t in self.terms if t.factor > 1), key=lambda t: -t.factor))

    def widening(self, symbol: str) -> float:
        """Return by what factor the intervals of a term are wider: its own, of slow terms the largest."""
        alike = SLOW if symbol in SLOW else {symbol}
        return max((term.factor for term in self.terms if term.symbol in alike), default=1.0)

"""The table of estimators: each is the mean square of a difference of the integrated samples.

With x the sum of the samples (the angle, for a gyroscope) and z the sum of x:

==============  ==================================================  =========
overlapping     x[t+2m] - 2 x[t+m] + x[t], every t                   2 m²
standard        the same, every m-th t                               2 m²
modified        z[t+3m] - 3 z[t+2m] + 3 z[t+m] - z[t], every t       2 m⁴
hadamard        x[t+3m] - 3 x[t+2m] + 3 x[t+m] - x[t], every t       6 m²
==============  ==================================================  =========

Source: NIST SP 1065 (2008), eqs. 9, 11, 15 (modified: its inner sum of m second differences of
x is a third difference of z), 22 (overlapping Hadamard).
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimator:
    """One estimator of a deviation.

    Attributes
    ----------
    name
        Its key in `ESTIMATORS`.
    integrations
        How often the samples are summed: 1 (x) or 2 (z).
    order
        Order of the difference.
    overlapping
        Whether every start point is used, or every m-th.
    weight
        Sum of the squared coefficients of the difference that the variance is divided by.
    """

    name: str
    integrations: int
    order: int
    overlapping: bool
    weight: int

    def terms(self, n: int, m: int) -> int:
        """Return the number of differences that `n` samples have at averaging factor `m`."""
        if self.overlapping:
            return n + self.integrations - self.order * m
        return n // m + 1 - self.order

    def largest(self, n: int) -> int:
        """Return the largest averaging factor that `n` samples allow; 0 if they allow none."""
        return max((n + self.integrations - 1) // self.order, 0)

    def drawn(self, n: int) -> int:
        """Return the largest factor of a named set: half the largest, where some 2 to 4 dof are left."""
        return max(self.largest(n) // 2, 1)

    def scale(self, m: int) -> float:
        """Return what the mean square of the differences is divided by."""
        return float(self.weight) * float(m) ** (2 * self.integrations)


#: Name -> estimator.
ESTIMATORS: dict[str, Estimator] = {
    estimator.name: estimator
    for estimator in (
        Estimator(name="overlapping", integrations=1, order=2, overlapping=True, weight=2),
        Estimator(name="standard", integrations=1, order=2, overlapping=False, weight=2),
        Estimator(name="modified", integrations=2, order=3, overlapping=True, weight=2),
        Estimator(name="hadamard", integrations=1, order=3, overlapping=True, weight=6),
    )
}


def estimator_named(name: str) -> Estimator:
    """Return the estimator called `name`.

    Raises
    ------
    ValueError
        If there is none.
    """
    if name not in ESTIMATORS:
        msg = f"estimator {name!r} is not known: expected one of {', '.join(ESTIMATORS)}"
        raise ValueError(msg)
    return ESTIMATORS[name]

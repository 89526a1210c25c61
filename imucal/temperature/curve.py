"""Curve: the bias of an axis as a function of the temperature, and of the temperature before."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from imucal.arrays import FloatArray, ReadOnlyArrays

#: What the bias follows: the present temperature, the temperature behind a lag, or the present one and its
#: difference from that behind a lag (a gradient in the part).
Kind: TypeAlias = Literal["present", "lagged", "gradient"]
KINDS: tuple[Kind, ...] = ("present", "lagged", "gradient")
#: Half-width of a 95 % interval in standard deviations.
Z95 = 1.959964


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve(ReadOnlyArrays):
    """bias = sum of coefficients[k] (x - reference_c)^k + gradient (L - T).

    T is the temperature in degrees Celsius and L that behind a first-order lag of `lag_s`. x is T, or L if
    the kind is ``lagged``, limited to the range from `low_c` to `high_c`. `coefficients`, shape (order + 1,),
    are in U/K^k, and the gradient in U/K. `covariance`, shape (c, c), c >= order, is that of the coefficients
    from k = 1 on; higher ones than the order may be uncertain, too. Files do not contain it.
    """

    kind: Kind
    reference_c: float
    low_c: float
    high_c: float
    coefficients: FloatArray
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)), compare=False)
    lag_s: float = 0.0
    gradient: float = 0.0

    @property
    def order(self) -> int:
        return self.coefficients.size - 1

    def static(self, temperature: FloatArray) -> FloatArray:
        """Return the bias at steady temperatures in degrees Celsius, shape (n,), in U."""
        offsets = np.clip(temperature, self.low_c, self.high_c) - self.reference_c
        return np.asarray(np.polynomial.polynomial.polyval(offsets, self.coefficients))

    def bias(self, temperature: FloatArray, lagging: FloatArray) -> FloatArray:
        """Return the bias, shape (n,), in U; `lagging` is the temperature behind `lag_s`."""
        followed = lagging if self.kind == "lagged" else temperature
        return self.static(followed) + self.gradient * (lagging - temperature)

    def half_width(self, temperature: FloatArray) -> FloatArray:
        """Return the 95 % half-width of the change of the bias from `reference_c`, shape (n,), in U."""
        offsets = np.clip(temperature, self.low_c, self.high_c) - self.reference_c
        slopes = offsets[:, None] ** np.arange(1, self.covariance.shape[0] + 1)
        variance = np.einsum("ni,ij,nj->n", slopes, self.covariance, slopes)
        return np.asarray(Z95 * np.sqrt(np.maximum(variance, 0.0)))

    def with_spread(self, others: Sequence[FloatArray]) -> "Curve":
        """Return the curve whose covariance contains the mean square difference from `others`.

        They are coefficients of curves with the same reference, shape (order + 1,) each.
        """
        size = max(self.order, *(other.size - 1 for other in others))
        covariance = np.zeros((size, size))
        covariance[: self.order, : self.order] = self.covariance
        for other in others:
            difference = np.zeros(size)
            difference[: other.size - 1] += other[1:]
            difference[: self.order] -= self.coefficients[1:]
            covariance += np.outer(difference, difference) / len(others)
        return replace(self, covariance=covariance)

    def about(self, reference_c: float, coefficients: FloatArray) -> "Curve":
        """Return the curve with coefficients about another reference; their covariance is unknown."""
        return replace(self, reference_c=reference_c, coefficients=coefficients, covariance=np.zeros((0, 0)))

    def without_constant(self) -> "Curve":
        """Return the change of the bias from `reference_c`."""
        return replace(self, coefficients=np.concatenate([[0.0], self.coefficients[1:]]))

    @property
    def change(self) -> float:
        """The largest difference of the static bias between two temperatures of the range, in U."""
        return float(np.ptp(self.static(np.linspace(self.low_c, self.high_c, 201))))

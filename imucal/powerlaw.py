"""The four power-law noises of one unit per sample, in closed form.

Everything of second order about a stationary-increment process follows from V(n), the
(generalised) variance of the sum of n consecutive samples:

    avar(m) = (4 V(m) - V(2m)) / (2 m^2)

They stand below `allan` and `noise`, because both the intervals of a curve and the terms of a
model are made of them. Per-sample units: sampling period 1, angular frequency in rad/sample.

Source: Guerrier, Molinari, Stebler: Allan variance (MOAV, Def. 4.3); Greenhall & Riley (2003),
"Uncertainty of stability variances based on finite differences".
"""

from enum import Enum

import numpy as np

from imucal.arrays import FloatArray

__all__ = ["PowerLaw", "odd_harmonic"]


def odd_harmonic(n: FloatArray) -> FloatArray:
    """Return O_n = sum of 1/(2j-1) for j = 1 … n; O_0 = 0."""
    from scipy.special import digamma

    n = np.asarray(n, dtype=np.float64)
    positive = np.maximum(n, 1.0)
    value = 0.5 * (digamma(positive + 0.5) + np.euler_gamma) + np.log(2.0)
    return np.where(n > 0, value, 0.0)


class PowerLaw(Enum):
    """A noise with a power-law spectrum, per-sample variance parameter 1.

    QUANTIZATION is the first difference of white noise of unit variance, WHITE has unit
    variance, FLICKER has psd 1/(2 sin(w/2)), WALK sums white steps of unit variance.
    """

    QUANTIZATION = "Q"
    WHITE = "N"
    FLICKER = "B"
    WALK = "K"

    def sum_variance(self, n: FloatArray) -> FloatArray:
        """Return V(n), the generalised variance of the sum of n samples; V is even, V(0) = 0."""
        n = np.abs(np.asarray(n, dtype=np.float64))
        match self:
            case PowerLaw.QUANTIZATION:
                return np.where(n == 0, 0.0, 2.0)
            case PowerLaw.WHITE:
                return n
            case PowerLaw.FLICKER:
                sums = (4 * n * n - 1) * odd_harmonic(n - 1) - (n - 1) * (3 * n + 1)
                return np.where(n == 0, 0.0, -sums / (2 * np.pi))
            case PowerLaw.WALK:
                return -(n**3 - n) / 6.0

    def avar(self, m: FloatArray) -> FloatArray:
        """Return the exact Allan variance at averaging factors `m`, shape (k,)."""
        m = np.asarray(m, dtype=np.float64)
        match self:
            case PowerLaw.QUANTIZATION:
                return 3.0 / m**2
            case PowerLaw.WHITE:
                return 1.0 / m
            case PowerLaw.FLICKER:
                return (4 * self.sum_variance(m) - self.sum_variance(2 * m)) / (2 * m * m)
            case PowerLaw.WALK:
                return (2 * m * m + 1) / (6 * m)

    def psd(self, omega: FloatArray) -> FloatArray:
        """Return the two-sided psd per sample at angular frequencies `omega`, rad/sample."""
        half = 2 * np.abs(np.sin(np.asarray(omega, dtype=np.float64) / 2))
        match self:
            case PowerLaw.QUANTIZATION:
                return half**2
            case PowerLaw.WHITE:
                return np.ones_like(half)
            case PowerLaw.FLICKER:
                return 1.0 / half
            case PowerLaw.WALK:
                return 1.0 / half**2

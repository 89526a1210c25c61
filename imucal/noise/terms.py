"""The noise terms: one small immutable class a term.

Coefficients are continuous and SI (rad/s/√Hz, …); every formula is exact for the process sampled
at tau0, so that nothing is off at the first averaging times. Two-sided psd.

Source: IEEE Std 952-1997, Annex C (coefficients); the discrete forms follow from `powerlaw`.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imucal.arrays import FloatArray
from imucal.noise.formulas import draw_flicker, gauss_markov_avar, gauss_markov_sum
from imucal.powerlaw import PowerLaw


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseTerm(ABC):
    """One term of a noise model.

    Class attributes: `symbol`, and `names` and `units` of the coefficient for a gyroscope and
    an accelerometer.
    """

    symbol: ClassVar[str]
    names: ClassVar[tuple[str, str]]
    units: ClassVar[tuple[str, str]]

    @property
    @abstractmethod
    def coefficient(self) -> float:
        """The coefficient, in the SI unit of `units`."""

    @abstractmethod
    def avar(self, m: FloatArray, tau0: float) -> FloatArray:
        """Return the Allan variance at averaging factors `m`, shape (k,), in U²."""

    @abstractmethod
    def psd(self, f: FloatArray, tau0: float) -> FloatArray:
        """Return the two-sided psd of the sampled process at `f` in Hz, shape (k,), in U²/Hz."""

    @abstractmethod
    def structure(self, k: FloatArray, tau0: float) -> FloatArray:
        """Return D(k), the mean square difference of samples `k` apart, shape (j,), in U²."""

    @abstractmethod
    def sum_variance(self, n: FloatArray, tau0: float) -> FloatArray:
        """Return V(n), the generalised variance of the sum of `n` samples, shape (j,), in U².

        See `imucal.powerlaw`: avar(m) = (4 V(m) - V(2m)) / (2 m²).
        """

    @abstractmethod
    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:
        """Return `n` samples, shape (n,), in U."""

    @abstractmethod
    def text(self) -> str:
        """Return the term as a model text holds it, such as ``N=0.001``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerLawTerm(NoiseTerm):
    """A term whose spectrum is a power law; `value` is its coefficient."""

    law: ClassVar[PowerLaw]
    value: float

    def __post_init__(self) -> None:
        _require_non_negative(self.symbol, self.value)

    @property
    def coefficient(self) -> float:
        return self.value

    @staticmethod
    @abstractmethod
    def per_sample(tau0: float) -> float:
        """Return the deviation per sample of a coefficient of 1."""

    def variance(self, tau0: float) -> float:
        """Return the variance parameter per sample, in U²."""
        return (self.value * self.per_sample(tau0)) ** 2

    def avar(self, m: FloatArray, tau0: float) -> FloatArray:
        return self.variance(tau0) * self.law.avar(m)

    def structure(self, k: FloatArray, tau0: float) -> FloatArray:
        return self.variance(tau0) * self.law.structure(k)

    def sum_variance(self, n: FloatArray, tau0: float) -> FloatArray:
        return self.variance(tau0) * self.law.sum_variance(n)

    def psd(self, f: FloatArray, tau0: float) -> FloatArray:
        return self.variance(tau0) * tau0 * self.law.psd(2 * np.pi * np.asarray(f) * tau0)

    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:
        return self.value * self.per_sample(tau0) * self._unit(n, rng)

    @abstractmethod
    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return `n` samples of variance parameter 1."""

    def text(self) -> str:
        return f"{self.symbol}={self.value!r}"


class Quantization(PowerLawTerm):
    """Quantization noise Q, in rad (m/s): white noise of the integral. Slope -1."""

    __slots__ = ()
    symbol = "Q"
    law = PowerLaw.QUANTIZATION
    names = ("quantization noise", "quantization noise")
    units = ("rad", "m/s")

    @staticmethod
    def per_sample(tau0: float) -> float:
        return 1 / tau0

    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        steps: FloatArray = np.diff(rng.standard_normal(n + 1))
        return steps


class AngleRandomWalk(PowerLawTerm):
    """Angle (velocity) random walk N, in rad/s/√Hz (m/s²/√Hz): white noise. Slope -1/2."""

    __slots__ = ()
    symbol = "N"
    law = PowerLaw.WHITE
    names = ("angle random walk", "velocity random walk")
    units = ("rad/s/sqrt(Hz)", "m/s^2/sqrt(Hz)")

    @staticmethod
    def per_sample(tau0: float) -> float:
        return float(1 / np.sqrt(tau0))

    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        return rng.standard_normal(n)


class BiasInstability(PowerLawTerm):
    """Bias instability B, in rad/s (m/s²): flicker. Slope 0; the floor lies at 0.664 B."""

    __slots__ = ()
    symbol = "B"
    law = PowerLaw.FLICKER
    names = ("bias instability", "bias instability")
    units = ("rad/s", "m/s^2")

    @staticmethod
    def per_sample(tau0: float) -> float:  # noqa: ARG004 - a floor has no time scale
        return 1.0

    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        return draw_flicker(n, rng)


class RateRandomWalk(PowerLawTerm):
    """Rate random walk K, in rad/s/√s (m/s²/√s): summed white noise. Slope +1/2."""

    __slots__ = ()
    symbol = "K"
    law = PowerLaw.WALK
    names = ("rate random walk", "acceleration random walk")
    units = ("rad/s/sqrt(s)", "m/s^2/sqrt(s)")

    @staticmethod
    def per_sample(tau0: float) -> float:
        return float(np.sqrt(tau0))

    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        return np.cumsum(rng.standard_normal(n))


@dataclass(frozen=True, slots=True, kw_only=True)
class RateRamp(NoiseTerm):
    """Rate ramp R, in rad/s² (m/s³): a steady drift. Slope +1. It has no spectrum."""

    symbol = "R"
    names = ("rate ramp", "acceleration ramp")
    units = ("rad/s^2", "m/s^3")
    value: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.value):
            msg = f"R must be finite, got {self.value}"
            raise ValueError(msg)

    @property
    def coefficient(self) -> float:
        return self.value

    def avar(self, m: FloatArray, tau0: float) -> FloatArray:
        tau = np.asarray(m, dtype=np.float64) * tau0
        return (self.value * tau) ** 2 / 2

    def structure(self, k: FloatArray, tau0: float) -> FloatArray:
        return (self.value * tau0 * np.asarray(k, dtype=np.float64)) ** 2

    def sum_variance(self, n: FloatArray, tau0: float) -> FloatArray:
        n = np.asarray(n, dtype=np.float64)
        return -((self.value * tau0) ** 2) * (n**4 - n**2) / 12

    def psd(self, f: FloatArray, tau0: float) -> FloatArray:  # noqa: ARG002 - deterministic
        return np.zeros_like(np.asarray(f, dtype=np.float64))

    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:  # noqa: ARG002
        return self.value * tau0 * np.arange(n, dtype=np.float64)

    def text(self) -> str:
        return f"R={self.value!r}"


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussMarkov(NoiseTerm):
    """First-order Gauss-Markov (AR1): standard deviation sigma and correlation time T in s.

    Sampled, it is x[t+1] = phi x[t] + q w[t] with phi = exp(-tau0/T), q² = sigma² (1 - phi²).
    """

    symbol = "GM"
    names = ("Gauss-Markov", "Gauss-Markov")
    units = ("rad/s", "m/s^2")
    sigma: float
    T: float

    def __post_init__(self) -> None:
        _require_non_negative("GM sigma", self.sigma)
        if not (np.isfinite(self.T) and self.T > 0):
            msg = f"GM T must be positive and finite, got {self.T}"
            raise ValueError(msg)

    @property
    def coefficient(self) -> float:
        return self.sigma

    def phi(self, tau0: float) -> float:
        """Return the correlation of neighbouring samples."""
        return float(np.exp(-tau0 / self.T))

    def q(self, tau0: float) -> float:
        """Return the standard deviation of the driving noise per sample, in U."""
        return float(self.sigma * np.sqrt(-np.expm1(-2 * tau0 / self.T)))

    def avar(self, m: FloatArray, tau0: float) -> FloatArray:
        return self.sigma**2 * gauss_markov_avar(np.asarray(m, np.float64), tau0 / self.T)

    def structure(self, k: FloatArray, tau0: float) -> FloatArray:
        lags = np.abs(np.asarray(k, dtype=np.float64))
        shape: FloatArray = -2 * np.expm1(-lags * tau0 / self.T)
        return self.sigma**2 * shape

    def sum_variance(self, n: FloatArray, tau0: float) -> FloatArray:
        return self.sigma**2 * gauss_markov_sum(np.abs(np.asarray(n, np.float64)), tau0 / self.T)

    def psd(self, f: FloatArray, tau0: float) -> FloatArray:
        a = tau0 / self.T
        half = 4 * np.sin(np.pi * np.asarray(f) * tau0) ** 2
        shape: FloatArray = -np.expm1(-2 * a) / (np.expm1(-a) ** 2 + np.exp(-a) * half)
        return self.sigma**2 * tau0 * shape

    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:
        from scipy.signal import lfilter

        phi = self.phi(tau0)
        start = self.sigma * rng.standard_normal()
        steps = self.q(tau0) * rng.standard_normal(n)
        samples, _ = lfilter([1.0], [1.0, -phi], steps, zi=np.array([phi * start]))
        return np.asarray(samples, dtype=np.float64)

    def text(self) -> str:
        return f"GM(sigma={self.sigma!r}, T={self.T!r})"


#: Symbol of a term -> its class, in the order of a rising slope.
TERMS: dict[str, type[NoiseTerm]] = {
    term.symbol: term
    for term in (Quantization, AngleRandomWalk, BiasInstability, GaussMarkov, RateRandomWalk, RateRamp)
}


def _require_non_negative(symbol: str, value: float) -> None:
    if not (np.isfinite(value) and value >= 0):
        msg = f"{symbol} must be finite and not negative, got {value}"
        raise ValueError(msg)

"""The base class of noise terms, and formulas per unit variance and sample."""

import math
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import ClassVar, Self

import numpy as np
import scipy

from imucal.arrays import FloatArray, IntArray
from imucal.powerlaw import PowerLaw, odd_harmonic
from imucal.recording import Sensor
from imucal.units import SAMPLE_UNITS, DatasheetUnit, datasheet_unit

#: Step in the logarithm of a parameter for a derivative.
_STEP = 1e-4
#: Fraction of the correlation time below which closed forms lose digits.
_SLOW = 0.05


@dataclass(frozen=True)
class Stroke:
    """Line style: colour on white, colour on black, dashes in points."""

    light: str
    dark: str
    dashes: tuple[float, ...]


@dataclass(frozen=True)
class Description:
    """Description of a term on the page."""

    in_the_curve: str
    meaning: str
    other_names: str


@dataclass(frozen=True, kw_only=True)
class NoiseTerm(ABC):
    """One term of a noise model. A new term needs only a subclass and its line in `TERMS`.

    The dataclass fields are the parameters, the coefficient first, to which the noise is proportional. A fit
    can estimate a coefficient alone or with a time ``T`` in s. Three methods define the noise: `structure`,
    `psd` and `simulate`. Override the others if there is a closed form.

    Class attributes
    ----------------
    symbol
        Letters in capitals.
    abbreviations
        Common names of the coefficient, in capitals, accepted wherever a user names a term.
    names, units
        Names and SI units of the coefficient, for a gyroscope and an accelerometer.
    datasheet
        Names in `imucal.units.DATASHEET_UNITS` of the units used in data sheets.
    divisors
        Divisor of the sample unit in a unit of the coefficient -> its factor in SI.
    slope
        Slope of the Allan deviation on logarithmic axes; None if it is not constant.
    read_at
        Where the curve shows the coefficient: tau in s (None if not fixed), and deviation / coefficient.
    fitted_by
        Methods of `imucal.fit` that can fit the term.
    always
        Whether every fit reports the term, with an upper bound if the data do not show it.
    repeatable
        Whether a model may contain it more than once.
    """

    symbol: ClassVar[str]
    abbreviations: ClassVar[tuple[str, ...]] = ()
    names: ClassVar[tuple[str, str]]
    units: ClassVar[tuple[str, str]]
    datasheet: ClassVar[tuple[str, str]]
    stroke: ClassVar[Stroke]
    description: ClassVar[Description]
    divisors: ClassVar[dict[str, float]] = {}
    slope: ClassVar[float | None] = None
    read_at: ClassVar[tuple[float | None, float]] = (None, 1.0)
    fitted_by: ClassVar[frozenset[str]] = frozenset()
    always: ClassVar[bool] = False
    repeatable: ClassVar[bool] = False

    @classmethod
    def parameters(cls) -> tuple[str, ...]:
        """Return the names of the parameters, the coefficient first."""
        return tuple(field.name for field in fields(cls))

    @classmethod
    def parameter_names(cls, key: str) -> tuple[str, ...]:
        """Return the parameters' names in a fit: ``N``, or ``GM1.sigma``, ``GM1.T`` for ``GM1``."""
        names = cls.parameters()
        return (key,) if len(names) == 1 else tuple(f"{key}.{name}" for name in names)

    @classmethod
    def of(cls, *values: float) -> Self:
        return cls(**dict(zip(cls.parameters(), values, strict=True)))

    @classmethod
    def parameter_texts(cls, text: str) -> tuple[str, ...] | None:
        """Return the parameter values in a text such as ``N=1e-3``; None if it is another term."""
        names, symbol = cls.parameters(), f"(?i:{'|'.join((cls.symbol, *cls.abbreviations))})"
        if len(names) == 1:
            pattern = rf"\s*{symbol}\s*=\s*([^\s].*?)\s*"
        else:
            inside = r"\s*,\s*".join(rf"{name}\s*=\s*([^\s,][^,]*?)" for name in names)
            pattern = rf"\s*{symbol}\s*\(\s*{inside}\s*\)\s*"
        match = re.fullmatch(pattern, text)
        return match.groups() if match else None

    @classmethod
    def name(cls, sensor: Sensor) -> str:
        """Return the usual name of the term, such as ``angle random walk``."""
        return cls.names[sensor is Sensor.ACCELEROMETER]

    @classmethod
    def unit(cls, sensor: Sensor) -> str:
        return cls.units[sensor is Sensor.ACCELEROMETER]

    @classmethod
    def coefficient_units(cls, sensor: Sensor) -> dict[str, float]:
        """Return units of the coefficient, SI first, each with its factor to SI."""
        datasheet = cls.datasheet_unit(sensor)
        units = {cls.unit(sensor): 1.0}
        for name, factor in SAMPLE_UNITS[sensor].items():
            units |= {f"{name}{over}": factor * divisor for over, divisor in cls.divisors.items()}
        return {**units, datasheet.name: 1 / datasheet.factor}

    @classmethod
    def datasheet_unit(cls, sensor: Sensor) -> DatasheetUnit:
        return datasheet_unit(cls.datasheet[sensor is Sensor.ACCELEROMETER])

    @classmethod
    def per_sample(cls, tau0: float) -> float:  # noqa: ARG003 - none for a coefficient in the sample's unit
        """Return the deviation per sample of a coefficient of 1."""
        return 1.0

    @property
    def coefficient(self) -> float:
        return float(getattr(self, self.parameters()[0]))

    @property
    def values(self) -> tuple[float, ...]:
        return tuple(float(getattr(self, name)) for name in self.parameters())

    def text(self) -> str:
        """Return the term as in a model's text; `parse` restores it exactly."""
        names = self.parameters()
        if len(names) == 1:
            return f"{self.symbol}={self.coefficient!r}"
        return f"{self.symbol}({', '.join(f'{name}={getattr(self, name)!r}' for name in names)})"

    def read_off(self) -> tuple[float | None, float]:
        """Return tau in s (None if not fixed) and the deviation that show the coefficient."""
        return self.read_at[0], self.read_at[1] * abs(self.coefficient)

    @abstractmethod
    def structure(self, k: FloatArray, tau0: float) -> FloatArray:
        """Return D(k), the mean square difference of samples `k` apart, shape (j,), in U²."""

    @abstractmethod
    def psd(self, f: FloatArray, tau0: float) -> FloatArray:
        """Return the two-sided psd of the sampled process at `f` in Hz, shape (k,), in U²/Hz."""

    @abstractmethod
    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:
        """Return `n` samples, shape (n,), in U."""

    def sum_variance(self, n: FloatArray, tau0: float) -> FloatArray:
        """Return V(n), the generalised variance of the sum of `n` samples, shape (j,), in U².

        V(n) = -sum over k < n of (n - k) D(k), up to a multiple of n², which cancels in avar(m) = (4 V(m) -
        V(2m)) / (2 m²).
        """
        n = np.abs(np.asarray(n, dtype=np.float64))
        k = np.arange(1.0, float(n.max(initial=1.0)))
        D = self.structure(k, tau0)
        total = np.concatenate([[0.0, 0.0], np.cumsum(D)])
        moment = np.concatenate([[0.0, 0.0], np.cumsum(k * D)])
        at = n.astype(np.int64)
        return np.asarray(moment[at] - n * total[at])

    def avar(self, m: FloatArray, tau0: float) -> FloatArray:
        """Return the Allan variance at averaging factors `m`, shape (k,), in U²."""
        m = np.asarray(m, dtype=np.float64)
        return (4 * self.sum_variance(m, tau0) - self.sum_variance(2 * m, tau0)) / (2 * m**2)

    def dct_slopes(
        self, n: int, first: IntArray, count: IntArray, tau0: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return the term's contribution to squared DCT-II ordinates of `n` samples, and its slopes.

        Bins are given by their `first` ordinate and `count`. The mean of E[X_k²] over each bin has shape
        (b,), its derivative in the logarithm of each parameter shape (p, b). This version uses the psd, the
        limit for long records.
        """
        frequency = (first + (count - 1) / 2) / (2 * n * tau0)
        expectation = self.psd(frequency, tau0) / tau0
        slopes = [2 * expectation]
        for name in self.parameters()[1:]:
            value = getattr(self, name)
            above, below = (replace(self, **{name: value * np.exp(s)}) for s in (_STEP, -_STEP))
            slopes.append((above.psd(frequency, tau0) - below.psd(frequency, tau0)) / (2 * _STEP * tau0))
        return expectation, np.array(slopes)

    @classmethod
    def dct_shapes(
        cls, log_time: FloatArray, lam: FloatArray, length: FloatArray, sign: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return `dct_slopes` of many terms of unit deviation per sample at once, for the fits.

        `log_time`, shape (c, 1), contains logs of the times in samples. For each bin, shape (b,), `lam` is
        the mean of 4 sin²(theta_k / 2), `length` the number of samples of its series and `sign` (-1)^k for a
        bin of one ordinate, 0 for wider bins. The mean of E[X_k²] and its derivative in the log of the time
        have shapes (c, b).
        """
        omega = 2 * np.arcsin(np.sqrt(np.minimum(lam, 4.0)) / 2)
        # A wide bin is evaluated at its middle.
        middle = length * omega / np.pi
        count = np.where(sign == 0, 2, 1)
        first = np.where(sign == 0, middle - 0.5, np.rint(middle))
        expectation, slope = np.zeros((2, log_time.size, lam.size))
        timed = len(cls.parameters()) > 1
        for row, time in enumerate(np.exp(log_time[:, 0]).tolist()):
            term = cls.of(1 / cls.per_sample(1.0), *[time] * timed)
            for n in np.unique(length).tolist():
                own = length == n
                expectation[row, own], slopes = term.dct_slopes(round(n), first[own], count[own], 1.0)
                slope[row, own] = slopes[1] if timed else 0.0
        return expectation, slope


@dataclass(frozen=True, kw_only=True)
class PowerLawTerm(NoiseTerm):
    """A term whose spectrum is a power law; `value` is its coefficient."""

    law: ClassVar[PowerLaw]
    fitted_by = frozenset({"mle", "gmwm", "slope"})
    value: float

    def __post_init__(self) -> None:
        require_non_negative(self.symbol, self.value)

    def variance(self, tau0: float) -> float:
        """Return the variance parameter per sample, in U²."""
        return (self.value * self.per_sample(tau0)) ** 2

    def structure(self, k: FloatArray, tau0: float) -> FloatArray:
        return self.variance(tau0) * self.law.structure(k)

    def sum_variance(self, n: FloatArray, tau0: float) -> FloatArray:
        return self.variance(tau0) * self.law.sum_variance(n)

    def psd(self, f: FloatArray, tau0: float) -> FloatArray:
        return self.variance(tau0) * tau0 * self.law.psd(2 * np.pi * np.asarray(f) * tau0)

    def dct_slopes(
        self, n: int, first: IntArray, count: IntArray, tau0: float
    ) -> tuple[FloatArray, FloatArray]:
        own = self.variance(tau0) * self.law.dct_spectrum(n, first, count)
        return own, 2 * own[np.newaxis]

    def simulate(self, n: int, tau0: float, rng: np.random.Generator) -> FloatArray:
        samples = self._unit(n, rng)
        samples *= self.value * self.per_sample(tau0)
        return samples

    @abstractmethod
    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return `n` samples of variance parameter 1."""


def require_non_negative(name: str, value: float) -> None:
    """Raise a ValueError for a parameter that is negative or not finite."""
    if not (np.isfinite(value) and value >= 0):
        raise ValueError(f"{name} must be finite and not negative, got {value}")


def gauss_markov_sum(n: FloatArray, a: float) -> FloatArray:
    """Return V(n) of a unit-variance AR1 with phi = exp(-a), at n >= 0.

    For a slow process the result omits a multiple of n², which would cost all digits.
    """
    x, scale = a * n, 2 * math.exp(-a) / math.expm1(-a) ** 2
    if a >= _SLOW:
        return np.asarray(n / math.tanh(a / 2) + np.expm1(-x) * scale)
    terms = x**3 * (1 / 6 - x * (1 / 24 - x * (1 / 120 - x * (1 / 720 - x * (1 / 5040 - x / 40320)))))
    rest = np.where(x < _SLOW, terms, -np.expm1(-x) - x + x**2 / 2)
    return np.asarray(n * (a / 3 - a**3 / 90 + a**5 / 2520) - rest * scale)


def draw_flicker(n: int, rng: np.random.Generator) -> FloatArray:
    """Return flicker with the exact structure function (4/pi) O_k, by circulant embedding.

    Source: Davies & Harte (1987).
    """
    if n == 0:
        return np.zeros(0)
    size = scipy.fft.next_fast_len(2 * n, real=True)
    half = size // 2
    structure = 4 / np.pi * odd_harmonic(np.arange(half + 2, dtype=np.float64))
    covariance = np.empty(half + 1)
    covariance[0] = structure[1]
    covariance[1:] = 0.5 * (structure[2:] + structure[:-2]) - structure[1:-1]
    circulant = np.concatenate([covariance, covariance[1 : size - half][::-1]])
    del structure, covariance
    spectrum = np.sqrt(np.maximum(scipy.fft.rfft(circulant).real, 0.0))
    del circulant
    # Overwrite in place: these arrays are the peak memory of a simulation.
    drawn = scipy.fft.rfft(rng.standard_normal(size), overwrite_x=True)
    drawn *= spectrum
    del spectrum
    steps = scipy.fft.irfft(drawn, size, overwrite_x=True)[:n]
    return np.cumsum(steps)


def gauss_markov_dct(
    log_time: FloatArray, lam: FloatArray, length: FloatArray, sign: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return `NoiseTerm.dct_shapes` of a unit-variance AR1.

    With phi = exp(-1/T), r = (-1)^k phi^n and den = (1 - phi)² + phi lam,

        E = (1 - phi²)/den [1 - (1 - r) (2 phi/n) (1 - phi) (1 + cos theta) / ((1 + phi) den)].
    """
    a = np.exp(-log_time)
    phi, one_minus = np.exp(-a), -np.expm1(-a)
    power = -np.expm1(-2 * a)
    inverse = 1 / (one_minus**2 + phi * lam)
    share = (2 * phi * one_minus / (1 + phi)) * ((2 - lam / 2) / length) * inverse
    # d/dlog T of a is -a.
    slope_den = (a * phi) * (lam - 2 * one_minus) * inverse
    slope_power = -2 * a * np.exp(-2 * a) / power
    slope_share = share * (a - a * phi * (1 / one_minus + 1 / (1 + phi)) - slope_den)
    bracket, slope_bracket = 1 - share, -slope_share
    # The finite length matters only in single ordinates.
    single = np.flatnonzero(sign)
    ends = sign[single] * np.exp(-length[single] * a)
    bracket[:, single] += ends * share[:, single]
    slope_bracket[:, single] += ends * (length[single] * a * share[:, single] + slope_share[:, single])
    shape = power * inverse
    return shape * bracket, shape * (bracket * (slope_power - slope_den) + slope_bracket)

"""The noise terms, one small class each, and their table.

Coefficients are continuous and SI (rad/s/√Hz, …). Every formula is exact for the process sampled at tau0,
also at the shortest averaging times. Two-sided psd.

Source: IEEE Std 952-1997, Annex C (coefficients, and their positions on the curve in table C.1); the
discrete forms follow from `powerlaw`.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy

from imucal.arrays import FloatArray, IntArray
from imucal.noise.term import (
    Description,
    NoiseTerm,
    PowerLawTerm,
    Stroke,
    draw_flicker,
    gauss_markov_dct,
    gauss_markov_sum,
    require_non_negative,
)
from imucal.powerlaw import PowerLaw


class Quantization(PowerLawTerm):
    """Quantization noise Q, in rad (m/s): white noise of the integral. Slope -1."""

    symbol = "Q"
    abbreviations = ("QN",)
    law = PowerLaw.QUANTIZATION
    names = ("quantization noise", "quantization noise")
    units = ("rad", "m/s")
    datasheet = ("arcsec", "m/s")
    slope = -1.0
    read_at = (math.sqrt(3), 1.0)
    stroke = Stroke("#8a6100", "#e6b64c", (1, 2))
    description = Description("slope −1, read at τ = √3 s", "rounding of the integrated output", "GMWM: QN")

    @classmethod
    def per_sample(cls, tau0: float) -> float:
        return 1 / tau0

    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        return np.asarray(np.diff(rng.standard_normal(n + 1)))


class AngleRandomWalk(PowerLawTerm):
    """Angle (velocity) random walk N, in rad/s/√Hz (m/s²/√Hz): white noise. Slope -1/2."""

    symbol = "N"
    abbreviations = ("ARW", "VRW", "WN")
    law = PowerLaw.WHITE
    names = ("angle random walk", "velocity random walk")
    units = ("rad/s/sqrt(Hz)", "m/s^2/sqrt(Hz)")
    datasheet = ("deg/sqrt(h)", "m/s/sqrt(h)")
    divisors: ClassVar[dict[str, float]] = {"/sqrt(Hz)": 1.0}
    slope = -0.5
    read_at = (1.0, 1.0)
    always = True
    stroke = Stroke("#b84300", "#ff9157", (6, 2))
    description = Description(
        "slope −1/2, read at τ = 1 s",
        "white noise of the rate; its integral is a random walk",
        "noise density; Kalibr: noise_density; GMWM: WN. Not Kalibr's random_walk",
    )

    @classmethod
    def per_sample(cls, tau0: float) -> float:
        return float(1 / np.sqrt(tau0))

    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        return rng.standard_normal(n)


class BiasInstability(PowerLawTerm):
    """Bias instability B, in rad/s (m/s²): flicker. Slope 0; the floor is at 0.664 B."""

    symbol = "B"
    abbreviations = ("BI", "FN")
    law = PowerLaw.FLICKER
    names = ("bias instability", "bias instability")
    units = ("rad/s", "m/s^2")
    datasheet = ("deg/h", "ug")
    divisors: ClassVar[dict[str, float]] = {"": 1.0}
    slope = 0.0
    read_at = (None, math.sqrt(2 * math.log(2) / math.pi))
    always = True
    stroke = Stroke("#00734f", "#36c99a", (6, 2, 1, 2))
    description = Description(
        "slope 0, floor at 0.664 B",
        "flicker noise: the bias wanders equally at all time scales",
        "often confused with the curve's minimum, which is at least 0.664 B",
    )

    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        return draw_flicker(n, rng)


class RateRandomWalk(PowerLawTerm):
    """Rate random walk K, in rad/s/√s (m/s²/√s): summed white noise. Slope +1/2."""

    symbol = "K"
    abbreviations = ("RRW", "RW")
    law = PowerLaw.WALK
    names = ("rate random walk", "acceleration random walk")
    units = ("rad/s/sqrt(s)", "m/s^2/sqrt(s)")
    datasheet = ("deg/h/sqrt(h)", "m/s^2/sqrt(h)")
    divisors: ClassVar[dict[str, float]] = {"/sqrt(s)": 1.0, "/sqrt(h)": 1 / 60}
    slope = 0.5
    read_at = (3.0, 1.0)
    always = True
    stroke = Stroke("#a63c78", "#ee8fc4", (10, 3))
    description = Description(
        "slope +1/2, read at τ = 3 s",
        "the bias moves in independent steps",
        "Kalibr: random_walk; bias random walk; GMWM: RW",
    )

    @classmethod
    def per_sample(cls, tau0: float) -> float:
        return float(np.sqrt(tau0))

    def _unit(self, n: int, rng: np.random.Generator) -> FloatArray:
        steps = rng.standard_normal(n)
        return np.cumsum(steps, out=steps)


@dataclass(frozen=True, kw_only=True)
class RateRamp(NoiseTerm):
    """Rate ramp R, in rad/s² (m/s³): a steady drift. Slope +1. It has no spectrum."""

    symbol = "R"
    abbreviations = ("RR", "DR")
    names = ("rate ramp", "acceleration ramp")
    units = ("rad/s^2", "m/s^3")
    datasheet = ("deg/h^2", "m/s^2/h")
    divisors: ClassVar[dict[str, float]] = {"/s": 1.0, "/h": 1 / 3600}
    slope = 1.0
    read_at = (math.sqrt(2), 1.0)
    fitted_by = frozenset({"mle", "gmwm", "slope"})
    stroke = Stroke("#4c6a00", "#a9cc45", (8, 2, 1, 2, 1, 2))
    description = Description("slope +1, read at τ = √2 s", "a steady drift, such as warming up", "GMWM: DR")
    value: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.value):
            raise ValueError(f"R must be finite, got {self.value}")

    @classmethod
    def per_sample(cls, tau0: float) -> float:
        return tau0

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


@dataclass(frozen=True, kw_only=True)
class GaussMarkov(NoiseTerm):
    """First-order Gauss-Markov (AR1): standard deviation sigma and correlation time T in s.

    Sampled, it is x[t+1] = phi x[t] + q w[t] with phi = exp(-tau0/T), q² = sigma² (1 - phi²).
    """

    symbol = "GM"
    abbreviations = ("AR1",)
    names = ("Gauss-Markov", "Gauss-Markov")
    units = ("rad/s", "m/s^2")
    datasheet = ("deg/h", "ug")
    divisors: ClassVar[dict[str, float]] = {"": 1.0}
    fitted_by = frozenset({"mle", "gmwm"})
    repeatable = True
    stroke = Stroke("#5c4a9e", "#a99cf0", (3, 1.5))
    description = Description(
        "a hump of 0.617 σ at 1.89 T",
        "a bias with the correlation time T; a filter state",
        "AR1, exponentially correlated noise",
    )
    sigma: float
    T: float

    def __post_init__(self) -> None:
        require_non_negative("GM sigma", self.sigma)
        if not (np.isfinite(self.T) and self.T > 0):
            raise ValueError(f"GM T must be positive and finite, got {self.T}")

    @classmethod
    def bank(cls, B: float, t_min: float, t_max: float, per_decade: float = 2.0) -> tuple["GaussMarkov", ...]:
        """Return terms whose sum approximates flicker of bias instability `B`, in U, for filters without it.

        The correlation times reach from `t_min` to `t_max`, spaced by a constant ratio r, with at least
        `per_decade` terms per decade. Each term has the variance B² ln(r)/pi. The sum has the spectrum of
        flicker between 1/(2 pi t_max) and 1/(2 pi t_min), except near these limits.
        For samples at tau0, t_min = tau0 / 2 is enough up to the Nyquist frequency. The ripple is 5.5 % at 1
        term `per_decade`, 0.08 % at 2. Times that do not increase, and a `B` or `per_decade` that is not
        positive, are a ValueError.

        Source: Keshner (1982), "1/f noise", Proc. IEEE 70, 212; the variance follows from the integral of
        sigma² 2T / (1 + (wT)²) over ln T.
        """
        if not (0 < t_min < t_max and B > 0 and per_decade > 0):
            given = f"{t_min}, {t_max}, {B}, {per_decade}"
            raise ValueError(f"need 0 < t_min < t_max, B > 0 and per_decade > 0, got {given}")
        steps = math.ceil(math.log10(t_max / t_min) * per_decade - 1e-9)
        ratio = (t_max / t_min) ** (1 / steps)
        sigma = B * math.sqrt(math.log(ratio) / math.pi)
        return tuple(cls(sigma=sigma, T=t_min * ratio**i) for i in range(steps + 1))

    def phi(self, tau0: float) -> float:
        """Return the correlation of neighbouring samples."""
        return float(np.exp(-tau0 / self.T))

    def q(self, tau0: float) -> float:
        """Return the standard deviation of the driving noise per sample, in U."""
        return float(self.sigma * np.sqrt(-np.expm1(-2 * tau0 / self.T)))

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
        phi = self.phi(tau0)
        start = self.sigma * rng.standard_normal()
        steps = self.q(tau0) * rng.standard_normal(n)
        samples, _ = scipy.signal.lfilter([1.0], [1.0, -phi], steps, zi=np.array([phi * start]))
        return np.asarray(samples, dtype=np.float64)

    def read_off(self) -> tuple[float | None, float]:
        # The hump: 0.437 q sqrt(T) = 0.617 sigma at 1.89 T, with the driving density q² = 2 sigma²/T.
        return 1.89 * self.T, 0.617 * self.sigma

    @classmethod
    def dct_shapes(
        cls, log_time: FloatArray, lam: FloatArray, length: FloatArray, sign: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        return gauss_markov_dct(log_time, lam, length, sign)

    def dct_slopes(
        self, n: int, first: IntArray, count: IntArray, tau0: float
    ) -> tuple[FloatArray, FloatArray]:
        single = count == 1
        sign = np.where(single, np.where(first % 2 == 0, 1.0, -1.0), 0.0)
        lam = 4 * np.sin(np.pi * (first + (count - 1) / 2) / n / 2) ** 2
        log_time = np.array([[np.log(self.T / tau0)]])
        shape, slope = gauss_markov_dct(log_time, lam, np.full(lam.shape, float(n)), sign)
        own = self.sigma**2 * shape[0]
        return own, np.array([2 * own, self.sigma**2 * slope[0]])


#: Symbol of a term -> its class, in the order of increasing slope.
TERMS: dict[str, type[NoiseTerm]] = {
    term.symbol: term
    for term in (
        Quantization,
        AngleRandomWalk,
        BiasInstability,
        GaussMarkov,
        RateRandomWalk,
        RateRamp,
    )
}

#: Symbols that every fit reports, with an upper bound if the data do not show the term.
ALWAYS = tuple(symbol for symbol, term in TERMS.items() if term.always)


def symbol_of(text: str) -> str | None:
    """Return the symbol for a symbol or abbreviation; None if unknown."""
    plain = text.strip().upper()
    return next((s for s, term in TERMS.items() if plain == s or plain in term.abbreviations), None)


def in_order(symbols: Iterable[str]) -> tuple[str, ...]:
    """Return symbols in the order of `TERMS`."""
    return tuple(sorted(symbols, key=list(TERMS).index))


def term_keys(symbols: Iterable[str]) -> tuple[str, ...]:
    """Return the names of terms in a fit: their symbols, numbered if a symbol is duplicated."""
    ordered = tuple(symbols)
    seen = dict.fromkeys(ordered, 0)
    keys = []
    for symbol in ordered:
        seen[symbol] += 1
        keys.append(symbol if ordered.count(symbol) == 1 else f"{symbol}{seen[symbol]}")
    return tuple(keys)


def require_fittable(symbols: Iterable[str], method: str) -> None:
    """Raise a ValueError for terms that a method cannot fit."""
    for symbol in symbols:
        term = TERMS[symbol]
        refusal = f"method {method!r} can't fit {symbol} ({term.names[0]})"
        if method not in term.fitted_by:
            others = " or ".join(repr(name) for name in sorted(term.fitted_by))
            msg = f"{refusal}; leave {symbol} out"
            msg += f" or use method {others}" if others else ", no other method can fit it either"
            raise ValueError(msg)
        if term.parameters()[1:] not in {(), ("T",)}:
            found, wanted = ", ".join(term.parameters()), "a coefficient and at most a time T"
            raise ValueError(f"{refusal}: it has {found}, expected {wanted}; leave {symbol} out")
        if method == "slope" and term.slope is None:
            raise ValueError(f"{refusal}: its curve has no single slope; leave {symbol} out")

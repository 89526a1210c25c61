"""Regressors: slow, known shapes that a fit removes by generalised least squares.

Places and times are in samples, places from the first sample of the record. The ordinates are those of the
likelihood, the DCT-II, in closed form where there is one. A stored result contains the names:

    R                    `Ramp`
    exp:<time constant>  `WarmUp`
    step:<place>         `Step`
    cos:<w>, sin:<w>     `Wave`, w in rad/sample: together a cycle
    temperature[:<lag>]  `TemperatureEffect`
    level:<place>,<width>  `LevelChange`
    bump:<place>,<width>   `Bump`
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy

from imucal.allan.dct import dct_ordinates, ramp_ordinates
from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError

#: Number of temperature means per requested ordinate: the lowest ordinates of a slow temperature then agree
#: with those of all samples to 1 % of the largest.
_MEANS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretch:
    """`n` even samples from place `offset` on; `temperature`, shape (n,), is in degrees Celsius."""

    n: int
    offset: int = 0
    temperature: FloatArray | None = None


class Regressor(ABC):
    """A shape in the samples, for a coefficient of 1."""

    #: The shape in a message, with its article.
    description: ClassVar[str]
    #: Whether a value depends on the samples before it, so that a part can't be computed alone.
    has_memory: ClassVar[bool] = False

    @property
    @abstractmethod
    def name(self) -> str:
        """The shape and its numbers as text, from which `parse` returns an equal regressor."""

    def __str__(self) -> str:
        return self.name

    @abstractmethod
    def samples(self, places: FloatArray, temperature: FloatArray | None = None, /) -> FloatArray:
        """Return the values at `places`, shape (n,).

        `temperature`, shape (n,), is in degrees Celsius at the places.
        """

    def ordinates(self, stretch: Stretch, count: int, /) -> FloatArray:
        """Return the ordinates k = 1 … count of a stretch of samples, shape (count,)."""
        places = stretch.offset + np.arange(stretch.n, dtype=np.float64)
        return dct_ordinates(self.samples(places, stretch.temperature))[:count]

    def parts(self, stretch: Stretch, count: int, /) -> Callable[[slice], FloatArray]:
        """Return a function that returns a part of the `ordinates`; index 0 is k = 1."""
        return self.ordinates(stretch, count).__getitem__


@dataclass(frozen=True, kw_only=True)
class Ramp(Regressor):
    """A rise of 1 per sample, the regressor of the term R."""

    description = "a ramp"

    @property
    def name(self) -> str:
        return "R"

    def samples(self, places: FloatArray, _temperature: FloatArray | None = None, /) -> FloatArray:
        return places

    def ordinates(self, stretch: Stretch, count: int, /) -> FloatArray:
        return ramp_ordinates(stretch.n, count)

    def parts(self, stretch: Stretch, _count: int, /) -> Callable[[slice], FloatArray]:
        """Return a function that computes each part alone: every fit has a ramp, so it is never stored."""
        return lambda part: ramp_ordinates(stretch.n, part.stop - part.start, first=part.start + 1)


@dataclass(frozen=True, kw_only=True)
class WarmUp(Regressor):
    """exp(-t / time_constant)."""

    description = "a warm-up"
    time_constant: float

    @property
    def name(self) -> str:
        return f"exp:{self.time_constant!r}"

    def samples(self, places: FloatArray, _temperature: FloatArray | None = None, /) -> FloatArray:
        return np.exp(-places / self.time_constant)

    def ordinates(self, stretch: Stretch, count: int, /) -> FloatArray:
        """Return sqrt(2/n) (1 - phi) cos(theta/2) (1 - (-1)^k phi^n) / den, times phi^offset.

        phi = exp(-1/time_constant), and den = (1 - phi)² + 4 phi sin²(theta/2).
        """
        n, time = stretch.n, self.time_constant
        k = np.arange(1, count + 1, dtype=np.float64)
        half = np.pi / (2 * n) * k
        one_minus = -np.expm1(-1 / time)
        ends = np.where(k % 2 == 1, 1 + np.exp(-n / time), -np.expm1(-n / time))
        den = one_minus**2 + 4 * np.exp(-1 / time) * np.sin(half) ** 2
        shape: FloatArray = np.sqrt(2 / n) * one_minus * np.cos(half) * ends / den
        return float(np.exp(-stretch.offset / time)) * shape


@dataclass(frozen=True, kw_only=True)
class Step(Regressor):
    """0 before a place, 1 from it on."""

    description = "a step"
    place: int

    @property
    def name(self) -> str:
        return f"step:{self.place}"

    def samples(self, places: FloatArray, _temperature: FloatArray | None = None, /) -> FloatArray:
        return (places >= self.place).astype(np.float64)

    def ordinates(self, stretch: Stretch, count: int, /) -> FloatArray:
        """Return -sqrt(2/n) sin(theta place) / (2 sin(theta/2)), or zero if the step is not inside."""
        n, place = stretch.n, self.place - stretch.offset
        if not 0 < place < n:
            return np.zeros(count)
        half = np.pi / (2 * n) * np.arange(1, count + 1, dtype=np.float64)
        return np.asarray(-np.sqrt(2 / n) * np.sin(2 * half * place) / (2 * np.sin(half)))


@dataclass(frozen=True, kw_only=True)
class Wave(Regressor):
    """cos(frequency (t + 1/2)), or the sine if `quadrature`; the frequency is in rad/sample."""

    description = "a cycle"
    frequency: float
    quadrature: bool = False

    @classmethod
    def pair(cls, frequency: float) -> "tuple[Wave, Wave]":
        """Return cosine and sine: a cycle of any phase."""
        return cls(frequency=frequency), cls(frequency=frequency, quadrature=True)

    @property
    def name(self) -> str:
        function = "sin" if self.quadrature else "cos"
        return f"{function}:{self.frequency!r}"

    def samples(self, places: FloatArray, _temperature: FloatArray | None = None, /) -> FloatArray:
        angle = self.frequency * (places + 0.5)
        return np.asarray(np.sin(angle) if self.quadrature else np.cos(angle))

    def ordinates(self, stretch: Stretch, count: int, /) -> FloatArray:
        """Return the `cycle_ordinates`; a sine is a cosine a quarter of a period later."""
        theta = np.pi / stretch.n * np.arange(1.0, count + 1)
        delay = np.pi / 2 if self.quadrature else 0.0
        return cycle_ordinates(stretch.n, theta, self.frequency, self.frequency * stretch.offset - delay)


@dataclass(frozen=True, kw_only=True)
class TemperatureEffect(Regressor):
    """The temperature behind a first-order lag, in samples.

    Samples without a temperature raise an ArgumentError.
    """

    description = "the effect of temperature"
    has_memory = True
    lag: float = 0.0

    @property
    def name(self) -> str:
        return f"temperature:{self.lag!r}" if self.lag else "temperature"

    def samples(self, _places: FloatArray, temperature: FloatArray | None = None, /) -> FloatArray:
        return lagged(self._required(temperature), self.lag)

    def ordinates(self, stretch: Stretch, count: int, /) -> FloatArray:
        """Return the ordinates of means over equal spans: fast, and the same at low frequencies."""
        n, temperature = stretch.n, self._required(stretch.temperature)
        spans = min(n, _MEANS * (count + 1))
        if spans < n:
            total = np.concatenate([[0.0], np.cumsum(temperature - temperature[0])])
            edges = np.interp(np.linspace(0, n, spans + 1), np.arange(n + 1.0), total)
            temperature = np.diff(edges) * (spans / n)
        ordinates = dct_ordinates(lagged(temperature, self.lag * spans / n))[:count]
        return np.asarray(ordinates * np.sqrt(n / spans))

    def _required(self, temperature: FloatArray | None) -> FloatArray:
        if temperature is None:
            raise ArgumentError(f"regressor {self.name!r} needs the temperature of the samples, got none")
        return temperature


@dataclass(frozen=True, kw_only=True)
class LevelChange(Regressor):
    """A step from 0 to 1 at a place, smoothed by a normal curve of the standard deviation `width`."""

    description = "a change of level"
    place: float
    width: float

    @property
    def name(self) -> str:
        return f"level:{self.place!r},{self.width!r}"

    def samples(self, places: FloatArray, _temperature: FloatArray | None = None, /) -> FloatArray:
        return np.asarray(scipy.special.ndtr((places - self.place) / self.width))

    def ordinates(self, stretch: Stretch, count: int, /) -> FloatArray:
        """Return the ordinates if the shape is mirrored at the ends of the stretch."""
        return self.ordinates_at(np.array([self.place]), self.width, stretch, count).reshape(count)

    @staticmethod
    def ordinates_at(places: FloatArray, width: float, stretch: Stretch, count: int) -> FloatArray:
        """Return the ordinates, shape (p, count), of one at each of the `places`, shape (p,).

        A mirrored shape is all that the cosine transform sees, so the smoothing is a factor of the ordinates
        of a step.
        """
        n = stretch.n
        theta = np.pi / n * np.arange(1.0, count + 1)
        inside = (places - stretch.offset)[:, np.newaxis]
        step = -np.sqrt(2 / n) * np.sin(inside * theta) / (2 * np.sin(theta / 2))
        within = (inside > 0) & (inside < n)
        return np.asarray(np.where(within, step * np.exp(-0.5 * (theta * width) ** 2), 0.0))


@dataclass(frozen=True, kw_only=True)
class Bump(Regressor):
    """A normal curve around a place, of the standard deviation `width` and the height 1."""

    description = "a bump"
    place: float
    width: float

    @property
    def name(self) -> str:
        return f"bump:{self.place!r},{self.width!r}"

    def samples(self, places: FloatArray, _temperature: FloatArray | None = None, /) -> FloatArray:
        return np.asarray(np.exp(-0.5 * ((places - self.place) / self.width) ** 2))

    def ordinates(self, stretch: Stretch, count: int, /) -> FloatArray:
        """Return the ordinates if the shape is mirrored at the ends of the stretch."""
        return self.ordinates_at(np.array([self.place]), self.width, stretch, count).reshape(count)

    @staticmethod
    def ordinates_at(places: FloatArray, width: float, stretch: Stretch, count: int) -> FloatArray:
        """Return the ordinates, shape (p, count), of one at each of the `places`, shape (p,)."""
        theta = np.pi / stretch.n * np.arange(1.0, count + 1)
        angles = (places - stretch.offset)[:, np.newaxis] * theta
        height = np.sqrt(2 / stretch.n) * np.sqrt(2 * np.pi) * width
        return np.asarray(height * np.cos(angles) * np.exp(-0.5 * (theta * width) ** 2))


#: Text before the colon of a name -> function of the text after it that returns the regressor.
SHAPES: dict[str, Callable[[str], Regressor]] = {
    "R": lambda _: Ramp(),
    "exp": lambda number: WarmUp(time_constant=float(number)),
    "step": lambda number: Step(place=int(number)),
    "cos": lambda number: Wave(frequency=float(number)),
    "sin": lambda number: Wave(frequency=float(number), quadrature=True),
    "temperature": lambda number: TemperatureEffect(lag=float(number or 0.0)),
    "level": lambda numbers: LevelChange(**_place_and_width(numbers)),
    "bump": lambda numbers: Bump(**_place_and_width(numbers)),
}


def _place_and_width(numbers: str) -> dict[str, float]:
    place, width = numbers.split(",")
    return {"place": float(place), "width": float(width)}


def parse(name: str) -> Regressor:
    """Return the regressor of a name in a stored result; raise a DataError if there is none."""
    shape, _, number = name.partition(":")
    try:
        return SHAPES[shape](number)
    except (KeyError, ValueError) as error:
        msg = f"regressor {name!r} of a stored fit: expected one of {', '.join(SHAPES)}; fit the log again"
        raise DataError(msg) from error


def cycle_ordinates(
    n: int, theta: FloatArray, omega: FloatArray | float, phase: FloatArray | float
) -> FloatArray:
    """Return the ordinates at angles `theta` = pi k/n of cos(omega (t + 1/2) + phase), t = 0 … n-1.

    With D(a) = sin(n a/2) / sin(a/2), Dirichlet's kernel: sqrt(2/n)/2 sum over a = omega ± theta of D(a)
    cos(n a/2 + phase). Arrays `omega` and `phase` broadcast with `theta`.
    """
    total: FloatArray | float = 0.0
    for angle in (omega + theta, omega - theta):
        sine, cosine = np.sin(n / 2 * angle), np.cos(n / 2 * angle)
        below = np.sin(angle / 2)
        kernel = np.divide(sine, below, out=np.full(below.shape, float(n)), where=below != 0)
        total = total + kernel * (cosine * np.cos(phase) - sine * np.sin(phase))
    return np.asarray(np.sqrt(2 / n) / 2 * total)


def lagged(samples: FloatArray, lag: float) -> FloatArray:
    """Return `samples` after a first-order lag, in samples, constant before the first."""
    if not lag > 0:
        return samples
    phi = float(np.exp(-1 / lag))
    followed = scipy.signal.lfilter([1 - phi], [1.0, -phi], samples - samples[0])
    return np.asarray(samples[0] + followed)

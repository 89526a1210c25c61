"""The data of the likelihood: sums of squared DCT ordinates in bins, and regressors.

A regressor is a slow, known shape that the fit removes by generalised least squares. Its name defines it;
places and times are in samples, from the first sample of the record:

    R                    the ramp
    exp:<time>           exp(-t/time), a warm-up
    step:<place>         0 before the place, 1 from it on
    cos:<w>, sin:<w>     of w (t + 1/2), w in rad/sample: together a cycle
    temperature[:<lag>]  the temperature, behind a first-order lag
    level:<place>,<width>  a step at the place, smoothed by a normal curve of this standard deviation
    bump:<place>,<width>   a normal curve around the place, of height 1
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

from imucal.allan.dct import DctBins, dct_ordinates, ramp_ordinates
from imucal.arrays import BoolArray, FloatArray, IntArray, read_only
from imucal.frozen import frozen_alone
from imucal.powerlaw import PowerLaw

#: The power-law terms, in the order of a rising slope.
LAWS = tuple(PowerLaw)
#: Row of flicker noise in a basis.
FLICKER = [law.value for law in LAWS].index("B")
#: First column after the variances of the power laws in a row of parameters.
SHAPED = len(LAWS)
#: Starting values use at most the bins of this many blocks.
_FEW_BLOCKS = 2
#: Fields of `Ordinates` with the bins along the last axis.
_BINNED = ("size", "power", "lam", "length", "sign", "basis", "cross", "gram")


@frozen_alone
class Ordinates:
    """Binned DCT ordinates, in scaled units: samples divided by `scale`, sampling period 1.

    `scale` is U per scaled unit: a power of two, so that scaling is exact. Each bin, shape (b,), has `size`
    degrees of freedom, `power`, the sum of their squares, `lam`, the mean of 4 sin²(theta/2), the `length` of
    its block in samples, and `sign`, (-1)^k for a single ordinate k and 0 for several. `basis`, shape (4, b),
    is the expected square for a unit variance of each of `LAWS`. `cross` and `gram` are as in `Bins`. `top`
    is lam at the end of the band.
    """

    scale: float
    size: FloatArray
    power: FloatArray
    lam: FloatArray
    length: FloatArray
    sign: FloatArray
    basis: FloatArray
    names: tuple[str, ...]
    cross: FloatArray
    gram: FloatArray
    top: float = 4.0

    @property
    def count(self) -> float:
        return float(self.size.sum())

    @property
    def samples(self) -> float:
        """Samples of the longest block."""
        return float(self.length.max())

    @property
    def fraction(self) -> FloatArray:
        """Frequency of each bin as a fraction of Nyquist."""
        return 2 / np.pi * np.arcsin(np.sqrt(np.minimum(self.lam, 4.0)) / 2)

    def __getitem__(self, select: BoolArray) -> "Ordinates":
        return replace(self, **{name: getattr(self, name)[..., select] for name in _BINNED})

    @classmethod
    def joined(cls, parts: Sequence["Ordinates"]) -> "Ordinates":
        """Return the bins of all parts, which share scale and regressors."""
        every: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in _BINNED
        }
        return replace(parts[0], **every)

    def below(self, fraction: float) -> "Ordinates":
        """Return the bins up to a fraction of Nyquist that are not empty."""
        chosen = self[(self.fraction <= fraction * (1 + 1e-9)) & (self.size > 0)]
        return replace(chosen, top=band_top(fraction))

    def rest(self, beta: FloatArray) -> FloatArray:
        """Return the sums of squares, shape (b,), after removing `beta`, shape (r,), times the regressors."""
        drift: FloatArray = np.einsum("i,ijb,j->b", beta, self.gram, beta) - 2 * beta @ self.cross
        return self.power + drift

    def unfiltered(self, response: FloatArray) -> "Ordinates":
        """Return the ordinates divided by the |H|² of an output filter, for starting values."""
        inverse = 1 + (self.lam[:, None] / self.top) ** np.arange(1, response.size + 1) @ response
        return replace(self, power=self.power * inverse, cross=self.cross * inverse, gram=self.gram * inverse)

    def with_averaged_flicker(self) -> "Ordinates":
        """Return the ordinates with the flicker noise of samples that are means of many faster ones.

        Its density is lam sum_k 1/|theta + 2 pi k|³: the density 1/|theta|, averaged over a sample and
        aliased. At Nyquist it is about half of 1/sqrt(lam), the flicker noise of a fractional difference.
        White noise stays white.
        """
        turn = self.fraction / 2
        aliased = scipy.special.zeta(3, turn) + scipy.special.zeta(3, 1 - turn)
        basis = self.basis.copy()
        basis[FLICKER] *= np.minimum(self.lam, 4.0) ** 1.5 * aliased / (2 * np.pi) ** 3
        return replace(self, basis=basis)

    def detrended(self) -> "Ordinates":
        """Return the ordinates minus a roughly fitted ramp."""
        if "R" not in self.names:
            return self
        at = self.names.index("R")
        weight = self.lam
        slope = (self.cross[at] @ weight) / (self.gram[at, at] @ weight)
        power = self.power - 2 * slope * self.cross[at] + slope**2 * self.gram[at, at]
        return replace(self, power=np.maximum(power, 1e-9 * self.power))


def band_top(fraction: float) -> float:
    """Return lam at a fraction of Nyquist."""
    return 4 * float(np.sin(np.pi / 2 * fraction)) ** 2


def bin_shapes(bins: DctBins) -> dict[str, Any]:
    """Return the fields of `Ordinates` that do not depend on the samples."""
    return {
        "lam": LAWS[0].psd(bins.omega),
        "length": np.full(bins.size, float(bins.n)),
        "sign": np.where(bins.count == 1, np.where(bins.first % 2 == 0, 1.0, -1.0), 0.0),
        "basis": _basis(bins),
    }


@lru_cache(maxsize=16)
def _basis(bins: DctBins) -> FloatArray:
    """Return the expected squares, cached: segments, and axes of equal length, have equal bins."""
    return read_only(np.array([law.dct_spectrum(bins.n, bins.first, bins.count) for law in LAWS]))


def coarser(ordinates: Ordinates, *, singles: int = 12, merge: int = 6) -> Ordinates:
    """Return fewer bins: the first `singles` of each block unchanged, then groups of `merge` bins."""
    size = ordinates.size
    starts = np.concatenate([[0], np.flatnonzero(np.diff(ordinates.lam) < 0) + 1, [size.size]])
    edges: list[int] = []
    for start, stop in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        edges += range(start, min(start + singles, stop))
        edges += range(start + singles, stop, merge)
    merged = _merged(ordinates, np.array(edges, dtype=np.int64))
    blocks = starts.size - 1
    if blocks <= _FEW_BLOCKS:
        return merged
    order = np.argsort(merged.lam, kind="stable")
    sorted_bins = replace(merged, **{name: getattr(merged, name)[..., order] for name in _BINNED})
    return _merged(sorted_bins, np.arange(0, order.size, -(-blocks // _FEW_BLOCKS)))


def _merged(ordinates: Ordinates, first: IntArray) -> Ordinates:
    """Return groups of bins as single bins; `first` are the indices of their first bins."""
    size = ordinates.size
    total = np.add.reduceat(size, first)
    single = np.diff(first, append=size.size) == 1

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values * size, first, axis=-1) / total)

    return replace(
        ordinates,
        size=total,
        power=np.add.reduceat(ordinates.power, first),
        lam=mean(ordinates.lam),
        length=ordinates.length[first],
        sign=np.where(single, ordinates.sign[first], 0.0),
        basis=mean(ordinates.basis),
        cross=np.add.reduceat(ordinates.cross, first, axis=-1),
        gram=np.add.reduceat(ordinates.gram, first, axis=-1),
    )


def exponential_ordinates(n: int, count: int, time: float, offset: int) -> FloatArray:
    """Return the ordinates k = 1 … count of exp(-(offset + t)/time), t = 0 … n-1.

    With phi = exp(-1/time): sqrt(2/n) (1 - phi) cos(theta/2) (1 - (-1)^k phi^n) / den, and den = (1 - phi)² +
    4 phi sin²(theta/2).
    """
    k = np.arange(1, count + 1, dtype=np.float64)
    half = np.pi / (2 * n) * k
    one_minus = -np.expm1(-1 / time)
    ends = np.where(k % 2 == 1, 1 + np.exp(-n / time), -np.expm1(-n / time))
    den = one_minus**2 + 4 * np.exp(-1 / time) * np.sin(half) ** 2
    shape: FloatArray = np.sqrt(2 / n) * one_minus * np.cos(half) * ends / den
    return float(np.exp(-offset / time)) * shape


#: Number of temperature means per requested ordinate.
_MEANS = 4


def regressor_ordinates(
    name: str, n: int, count: int, *, offset: int = 0, temperature: FloatArray | None = None
) -> FloatArray:
    """Return the ordinates k = 1 … count of a regressor in `n` samples from place `offset` on."""
    if name.startswith(("level:", "bump:")):
        kind, place, width = parsed_level(name)
        theta = np.pi / n * np.arange(1.0, count + 1)
        places = np.array([place - offset])
        shape: FloatArray = level_ordinates(n, theta, places, width, bump=kind == "bump")[0]
        return shape
    kind, value = _parsed(name)
    if kind == "temperature":
        if temperature is None:
            raise ValueError(f"regressor {name!r} needs the temperature of the samples, got none")
        # Transform means over equal spans: fast, and the same at low frequencies.
        spans = min(n, _MEANS * (count + 1))
        if spans < n:
            total = np.concatenate([[0.0], np.cumsum(temperature - temperature[0])])
            edges = np.interp(np.linspace(0, n, spans + 1), np.arange(n + 1.0), total)
            temperature = np.diff(edges) * (spans / n)
        ordinates = dct_ordinates(lagged(temperature, value * spans / n))[:count]
        return np.asarray(ordinates * np.sqrt(n / spans))
    if kind in {"cos", "sin"}:
        theta, quarter = np.pi / n * np.arange(1.0, count + 1), np.pi / 2 if kind == "sin" else 0.0
        return cycle_ordinates(n, theta, value, value * offset - quarter)
    closed: dict[str, Callable[[], FloatArray]] = {
        "R": lambda: ramp_ordinates(n, count),
        "exp": lambda: exponential_ordinates(n, count, value, offset),
        "step": lambda: step_ordinates(n, count, value - offset),
    }
    return closed[kind]()


def _parsed(name: str) -> tuple[str, float]:
    kind, _, text = name.partition(":")
    return kind, float(text or 0.0)


def regressor_samples(name: str, places: FloatArray, temperature: FloatArray | None = None) -> FloatArray:
    """Return the regressor at `places` from the first sample of the record."""
    if name.startswith(("level:", "bump:")):
        kind, place, width = parsed_level(name)
        distance = (places - place) / width
        if kind == "bump":
            return np.asarray(np.exp(-0.5 * distance**2))
        return np.asarray(scipy.special.ndtr(distance))
    kind, value = _parsed(name)
    if kind == "temperature" and temperature is not None:
        return lagged(temperature, value)
    shapes: dict[str, Callable[[], FloatArray]] = {
        "R": lambda: places,
        "exp": lambda: np.exp(-places / value),
        "step": lambda: (places >= value).astype(np.float64),
        "cos": lambda: np.cos(value * (places + 0.5)),
        "sin": lambda: np.sin(value * (places + 0.5)),
    }
    return shapes[kind]()


def parsed_level(name: str) -> tuple[str, float, float]:
    """Return kind, place and width of a change of level or a bump."""
    kind, _, text = name.partition(":")
    place, _, width = text.partition(",")
    return kind, float(place), float(width)


def level_ordinates(n: int, theta: FloatArray, places: FloatArray, width: float, *, bump: bool) -> FloatArray:
    """Return the ordinates at angles `theta` = pi k/n, shape (K,), of changes of level, shape (p, K).

    A change of level is a step at one of the `places`, shape (p,), smoothed by a normal curve of the standard
    deviation `width`, in samples; a bump is this curve itself, with height 1. Beyond the ends of the record
    both are mirrored, as all that the cosine transform sees: then the smoothing is a factor of the ordinates.
    """
    smoothing = np.exp(-0.5 * (theta * width) ** 2)
    angles = places[:, np.newaxis] * theta
    if bump:
        return np.asarray(np.sqrt(2 / n) * np.sqrt(2 * np.pi) * width * np.cos(angles) * smoothing)
    inside = (places > 0) & (places < n)
    return np.asarray(
        np.where(inside[:, np.newaxis], -np.sqrt(2 / n) * np.sin(angles), 0.0)
        / (2 * np.sin(theta / 2))
        * smoothing
    )


def step_ordinates(n: int, count: int, place: float) -> FloatArray:
    """Return the ordinates k = 1 … count of a step from 0 to 1 at sample `place`.

    -sqrt(2/n) sin(theta place) / (2 sin(theta/2)), or zero if the step is not inside.
    """
    if not 0 < place < n:
        return np.zeros(count)
    half = np.pi / (2 * n) * np.arange(1, count + 1, dtype=np.float64)
    return np.asarray(-np.sqrt(2 / n) * np.sin(2 * half * place) / (2 * np.sin(half)))


def cycle_ordinates(
    n: int, theta: FloatArray, omega: FloatArray | float, phase: FloatArray | float
) -> FloatArray:
    """Return the ordinates at angles `theta` = pi k/n of cos(omega (t + 1/2) + phase), t = 0 … n-1.

    With D(a) = sin(n a/2) / sin(a/2), Dirichlet's kernel: sqrt(2/n)/2 sum over a = omega ± theta of D(a)
    cos(n a/2 + phase).
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

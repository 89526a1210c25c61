"""The data of the likelihood: sums of squared DCT ordinates in bins, and their products with regressors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

from imucal.allan.dct import DctBins
from imucal.arrays import BoolArray, FloatArray, IntArray, read_only
from imucal.fitting.regressors import Ramp, Regressor
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Ordinates:
    """Binned DCT ordinates, in scaled units: samples divided by `scale`, sampling period 1.

    `scale` is U per scaled unit: a power of two, so that scaling is exact. Each bin, shape (b,), has `size`
    degrees of freedom, `power`, the sum of their squares, `lam`, the mean of 4 sin²(theta/2), the `length` of
    its block in samples, and `sign`, (-1)^k for a single ordinate k and 0 for several. `basis`, shape (4, b),
    is the expected square for a unit variance of each of `LAWS`. `cross` and `gram` are as in `Bins`, for the
    `regressors`. `top` is lam at the end of the band.
    """

    scale: float
    size: FloatArray
    power: FloatArray
    lam: FloatArray
    length: FloatArray
    sign: FloatArray
    basis: FloatArray
    regressors: tuple[Regressor, ...]
    cross: FloatArray
    gram: FloatArray
    top: float = 4.0

    @property
    def count(self) -> float:
        return float(self.size.sum())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the regressors; that of the ramp is the symbol of the term R."""
        return tuple(regressor.name for regressor in self.regressors)

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
        if Ramp() not in self.regressors:
            return self
        at = self.regressors.index(Ramp())
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

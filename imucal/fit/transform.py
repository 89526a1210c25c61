"""Samples -> Ordinates: scale, transform, leave lines out, bin."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucal.allan.dct import DctBins, dct_bins, dct_ordinates
from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.fit.ordinates import LAWS, Ordinates, ramp_ordinates

__all__ = ["Block", "bin_blocks", "scale_of", "transform"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """The ordinates of one unbroken run of samples, in scaled units.

    Attributes
    ----------
    bins
        Their bins.
    ordinates
        X_k for k = 1 … n-1, shape (n-1,).
    kept
        Which of them are used, shape (n-1,); None for all.
    regressors
        Name -> DCT-II ordinates of what is taken out by least squares, each of shape (n-1,).
    loss
        Share of each bin's information that missing samples took, shape (b,); None for none.
    """

    bins: DctBins
    ordinates: FloatArray
    kept: NDArray[np.bool_] | None
    regressors: dict[str, FloatArray]
    loss: FloatArray | None = None


def scale_of(samples: FloatArray, name: str) -> float:
    """Return a power of two near the size of the samples' steps, in U.

    Raises
    ------
    DataError
        If there are no steps: all samples are equal, or the steps are not finite.
    """
    size = float(np.sqrt(np.mean(np.square(np.diff(samples / _safe(samples)))))) * _safe(samples)
    if not (np.isfinite(size) and size > 0):
        msg = (
            f"{name}: all {samples.size} samples are equal, expected noise; "
            "check that the sensor was on and that its resolution shows its noise"
        )
        raise DataError(msg)
    return float(2.0 ** np.round(np.log2(size)))


def _safe(samples: FloatArray) -> float:
    """Return the largest sample's size, so that squares neither overflow nor vanish."""
    largest = float(np.max(np.abs(samples), initial=0.0))
    return largest if largest > 0 else 1.0


def transform(samples: FloatArray, *, ramp: bool = True) -> Block:
    """Return the ordinates of an unbroken run of scaled samples."""
    n = samples.size
    regressors = {"R": ramp_ordinates(n)} if ramp else {}
    return Block(bins=dct_bins(n), ordinates=dct_ordinates(samples), kept=None, regressors=regressors)


def bin_blocks(blocks: list[Block], scale: float) -> Ordinates:
    """Return the binned ordinates of all blocks; the regressors are common to them."""
    parts = [_bin(block) for block in blocks]
    names = tuple(blocks[0].regressors)

    def join(key: str) -> FloatArray:
        return np.concatenate([part[key] for part in parts], axis=-1)

    return Ordinates(
        scale=scale,
        size=join("size"),
        power=join("power"),
        lam=join("lam"),
        length=join("length"),
        sign=join("sign"),
        basis=join("basis"),
        names=names,
        cross=join("cross"),
        gram=join("gram"),
    )


def _bin(block: Block) -> dict[str, FloatArray]:
    bins, x = block.bins, block.ordinates
    kept = block.kept
    seen = x if kept is None else np.where(kept, x, 0.0)

    def total(values: FloatArray) -> FloatArray:
        summed: FloatArray = np.add.reduceat(values, bins.first - 1)
        return summed

    size = bins.count.astype(np.float64) if kept is None else total(kept.astype(np.float64))
    power = total(seen * seen)
    vectors = [v if kept is None else np.where(kept, v, 0.0) for v in block.regressors.values()]
    cross = np.array([total(seen * v) for v in vectors]).reshape(len(vectors), bins.size)
    gram = np.array([[total(v * w) for w in vectors] for v in vectors])
    gram = gram.reshape(len(vectors), len(vectors), bins.size)
    if block.loss is not None:
        keep = 1 - block.loss
        size, power, cross, gram = size * keep, power * keep, cross * keep, gram * keep
    return {
        "size": size,
        "power": power,
        "lam": LAWS[0].psd(bins.omega),
        "length": np.full(bins.size, float(bins.n)),
        "sign": np.where(bins.count == 1, np.where(bins.first % 2 == 0, 1.0, -1.0), 0.0),
        "basis": np.array([law.dct_spectrum(bins.n, bins.first, bins.count) for law in LAWS]),
        "cross": cross,
        "gram": gram,
    }

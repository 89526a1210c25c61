"""Blocks -> Ordinates: sums of squares in bins, and of products with the regressors."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.spectral.blocks import Block
from imucal.fitting.spectral.ordinates import LAWS, Ordinates

#: Square of the relative rounding error of a transform.
_ROUNDING = 1e-28


def bin_blocks(blocks: Sequence[Block], scale: float, names: tuple[str, ...] = ("R",)) -> Ordinates:
    """Return the binned ordinates of all blocks; the regressors `names` are common to them."""
    parts = [_bin(block, names) for block in blocks]
    joined: dict[str, Any] = {key: np.concatenate([part[key] for part in parts], axis=-1) for key in parts[0]}
    return Ordinates(scale=scale, names=names, **joined)


def _bin(block: Block, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the arrays of one block's `Ordinates`, by their names."""
    bins, kept = block.bins, block.kept

    def total(values: FloatArray) -> FloatArray:
        used = values if kept is None else np.where(kept, values, 0.0)
        summed: FloatArray = np.add.reduceat(used, bins.first - 1)
        return summed

    count = bins.count.astype(np.float64)
    size = count if kept is None else np.add.reduceat(kept.astype(np.float64), bins.first - 1)
    square = block.ordinates**2
    # The transform's own rounding: no bin of exactly no power, not even of a straight line.
    square += _ROUNDING * float(square.mean())
    power = total(square if block.variance is None else square + block.variance)
    vectors = [block.regressor(name) for name in names]
    cross = np.array([total(block.ordinates * v) for v in vectors]).reshape(len(names), bins.size)
    gram = np.zeros((len(names), len(names), bins.size))
    for i, v in enumerate(vectors):
        for j, w in enumerate(vectors[: i + 1]):
            gram[i, j] = gram[j, i] = total(v * w)
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

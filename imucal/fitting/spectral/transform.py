"""Blocks -> Ordinates: sums of squares in bins, and of products with the regressors."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from imucal.allan.dct import DctBins
from imucal.arrays import BoolArray, FloatArray, IntArray, read_only
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
    bins = block.bins
    vectors = [block.regressor_parts(name) for name in names]
    size, power = np.empty((2, bins.size))
    cross = np.empty((len(names), bins.size))
    gram = np.empty((len(names), len(names), bins.size))
    whole = 0.0
    for here, seen, starts in bins.parts():
        kept = None if block.kept is None else block.kept[seen]

        def total(values: FloatArray, kept: BoolArray | None = kept, starts: IntArray = starts) -> FloatArray:
            summed: FloatArray = np.add.reduceat(values if kept is None else values * kept, starts)
            return summed

        own = block.ordinates[seen]
        square = own * own
        whole += float(square.sum())
        size[here] = bins.count[here] if kept is None else total(np.ones(own.size))
        power[here] = total(square if block.variance is None else square + block.variance[seen])
        columns = [part_of(seen) for part_of in vectors]
        for i, v in enumerate(columns):
            cross[i, here] = total(own * v)
            for j, w in enumerate(columns[: i + 1]):
                gram[i, j, here] = gram[j, i, here] = total(v * w)
    # The transform's own rounding: no bin of exactly no power, not even of a straight line.
    power += _ROUNDING * whole / block.ordinates.size * size
    if block.loss is not None:
        keep = 1 - block.loss
        size, power, cross, gram = size * keep, power * keep, cross * keep, gram * keep
    return {
        "size": size,
        "power": power,
        "lam": LAWS[0].psd(bins.omega),
        "length": np.full(bins.size, float(bins.n)),
        "sign": np.where(bins.count == 1, np.where(bins.first % 2 == 0, 1.0, -1.0), 0.0),
        "basis": _basis(bins),
        "cross": cross,
        "gram": gram,
    }


@lru_cache(maxsize=16)
def _basis(bins: DctBins) -> FloatArray:
    """Return the expected squares; segments, and axes of the same length, have the very same bins."""
    return read_only(np.array([law.dct_spectrum(bins.n, bins.first, bins.count) for law in LAWS]))

"""Ordinates -> the bins that a result keeps, and back: exactly, for one record or for several."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from imucal.fitting.bins import Bins
from imucal.fitting.spectral.blocks import SeriesBlocks
from imucal.fitting.spectral.ordinates import LAWS, Ordinates


def bins_of(whole: Ordinates, blocks: SeriesBlocks, *, tau0: float, widening: float) -> Bins:
    """Return what is kept of the ordinates of a whole spectrum, which are those of `blocks`."""
    every = [block.bins for block in blocks.blocks]
    return Bins(
        n=np.array([bins.n for bins in every], dtype=np.int64),
        start=np.cumsum([0, *(bins.size for bins in every[:-1])]),
        first=np.concatenate([bins.first for bins in every]),
        size=whole.size,
        power=whole.power,
        names=whole.names,
        cross=whole.cross,
        gram=whole.gram,
        scale=blocks.scale,
        tau0=tau0,
        widening=widening,
    )


def ordinates_of(bins: Bins) -> Ordinates:
    """Return the ordinates that `bins` were made of, bit for bit."""
    lam, length, sign, basis = [], [], [], []
    for n, first in zip(bins.n.tolist(), np.split(bins.first, bins.start[1:]), strict=True):
        count = np.diff(first, append=n)
        # As `imucal.allan.dct.dct_bins` has it, so that no digit differs.
        lam.append(LAWS[0].psd(np.pi * (first + (count - 1) / 2) / n))
        length.append(np.full(first.size, float(n)))
        sign.append(np.where(count == 1, np.where(first % 2 == 0, 1.0, -1.0), 0.0))
        basis.append(np.array([law.dct_spectrum(n, first, count) for law in LAWS]))
    return Ordinates(
        scale=bins.scale,
        size=bins.size,
        power=bins.power,
        lam=np.concatenate(lam),
        length=np.concatenate(length),
        sign=np.concatenate(sign),
        basis=np.concatenate(basis, axis=1),
        names=bins.names,
        cross=bins.cross,
        gram=bins.gram,
    )


def joined(records: Sequence[Ordinates]) -> Ordinates:
    """Return the ordinates of several records as those of one: their likelihoods multiply.

    The ramp is common to them, and in the scale of the first; what else was taken out of a record is a
    regressor of its own, ``2:step@1000`` for the third record's, because a step is one record's alone.
    """
    scale = records[0].scale
    names = ("R", *(f"{i}:{name}" for i, one in enumerate(records) for name in one.names[1:]))
    total = sum(one.size.size for one in records)
    cross, gram = np.zeros((len(names), total)), np.zeros((len(names), len(names), total))
    start, first = 0, 1
    for one in records:
        bins, own = slice(start, start + one.size.size), len(one.names) - 1
        rows = np.array([0, *range(first, first + own)])
        cross[rows, bins] = one.cross * (one.scale / scale)
        gram[rows[:, None], rows, bins] = one.gram
        start, first = bins.stop, first + own
    whole = replace(records[0], names=names, cross=cross, gram=gram)
    power = np.concatenate([one.power * (one.scale / scale) ** 2 for one in records])
    same: dict[str, Any] = {
        name: np.concatenate([getattr(one, name) for one in records], axis=-1)
        for name in ("size", "lam", "length", "sign", "basis")
    }
    return replace(whole, power=power, **same)

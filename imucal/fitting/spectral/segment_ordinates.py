"""A record cut into segments of equal time: each segment's own ordinates, lines and gaps as in the whole.

Nothing is looked for again: the scale, the lines that are left out, the drift, and what the gaps miss
are those of the record's blocks.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucal.allan.dct import dct_bins, dct_ordinates, fast_length
from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.blocks import Block
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.fitting.spectral.regressors import regressor_samples
from imucal.fitting.spectral.transform import bin_blocks
from imucal.recording import AxisSeries

#: Fewest samples of a segment, and of a part of it between two long gaps.
_FEWEST, _FEWEST_IN_PART = 2048, 64
#: Fewest segments that show how a term changes.
_LEAST = 3
#: The bins of a segment: its spectrum is known roughly, and the model's mean over a bin exactly.
_SINGLES, _PER_OCTAVE = 16, 12
#: Fewest ordinates that are left out on each side of a line.
_REACH = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SegmentOrdinates:
    """The ordinates of each segment.

    Attributes
    ----------
    ordinates
        Those of all segments, one after the other; no regressors.
    first
        Place of each segment's first bin, shape (s,).
    start_s, end_s
        When each segment begins and ends, shape (s,), in s from the first sample.
    """

    ordinates: Ordinates
    first: IntArray
    start_s: FloatArray
    end_s: FloatArray


def number_of_segments(samples: int, wanted: int) -> int:
    """Return how many segments a record is cut into: fewer where it is short, 0 for none."""
    count = min(wanted, samples // _FEWEST)
    return count if count >= min(_LEAST, wanted) > 1 else 0


def segment_ordinates(
    series: AxisSeries,
    blocks: tuple[Block, ...],
    *,
    drift: Mapping[str, float],
    scale: float,
    wanted: int,
    fraction: float,
) -> SegmentOrdinates | None:
    """Return the ordinates of each segment, or None where the record is too short for any.

    A segment of which the gaps leave too little is left out.

    Parameters
    ----------
    series
        Finite samples.
    blocks
        Their blocks.
    drift
        Name of a regressor -> its coefficient in scaled units: what is taken out.
    scale
        U per scaled unit.
    wanted
        Most segments.
    fraction
        Upper end of the band, as a fraction of Nyquist.
    """
    count = number_of_segments(series.n, wanted)
    if not count:
        return None
    clock = series.clock
    edges = np.linspace(0, clock.grid_size, count + 1).round().astype(np.int64)
    parts: list[Ordinates] = []
    kept: list[int] = []
    for number, (start, stop) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        pieces = []
        for block in blocks:
            low, high = max(start, block.offset), min(stop, block.offset + block.bins.n)
            piece = _piece(series, block, drift=drift, scale=scale, place=low, size=high - low)
            pieces += [piece] if piece else []
        if sum(piece.bins.n for piece in pieces) >= _FEWEST // 2:
            parts.append(bin_blocks(pieces, scale, ()).below(fraction))
            kept.append(number)
    if len(kept) < 2:
        return None
    sizes = [part.size.size for part in parts]
    return SegmentOrdinates(
        ordinates=_joined(parts),
        first=np.cumsum([0, *sizes[:-1]]),
        start_s=np.asarray(edges[kept] * series.tau0, dtype=np.float64),
        end_s=np.asarray(edges[np.array(kept) + 1] * series.tau0, dtype=np.float64),
    )


def _joined(parts: list[Ordinates]) -> Ordinates:
    binned = ("size", "power", "lam", "length", "sign", "basis", "cross", "gram")
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in binned
    }
    return replace(parts[0], **arrays)


def _piece(
    series: AxisSeries,
    block: Block,
    *,
    drift: Mapping[str, float],
    scale: float,
    place: int,
    size: int,
) -> Block | None:
    """Return the part of a block from a place of the grid on; None where little of it was measured."""
    size = fast_length(max(size, 0))
    clock = series.clock
    first, stop = clock.index_from(place), clock.index_from(place + size)
    if stop - first < max(_FEWEST_IN_PART, size // 2):
        return None
    seen = slice(first, stop)
    samples = series.samples[seen] / scale
    missing = size - samples.size
    if missing and block.drawn is not None:
        before = place - block.offset - (first - clock.index_from(block.offset))
        own = clock.slice(first, stop)
        at = own.grid() + (own.segments[0].offset - clock.segments[0].offset - place)
        samples = _between(samples, at, block.drawn[before : before + missing])
    for name, coefficient in drift.items():
        samples -= coefficient * _regressor(name, block, place, size)
    bins = dct_bins(size, singles=_SINGLES, per_octave=_PER_OCTAVE)
    return Block(
        offset=place,
        bins=bins,
        ordinates=dct_ordinates(samples),
        kept=_kept(block, size),
        loss=_loss(block, bins.omega, missing / size) if missing else None,
    )


def _regressor(name: str, block: Block, place: int, size: int) -> FloatArray:
    """Return a regressor at places of the grid; what lags, from the beginning of the block on."""
    first = place - block.offset
    stop = first + size
    start = 0 if name.startswith("temperature") else first
    places = block.offset + np.arange(start, stop, dtype=np.float64)
    temperature = None if block.temperature is None else block.temperature[start:stop]
    return regressor_samples(name, places, temperature)[first - start :]


def _between(samples: FloatArray, at: IntArray, drawn: FloatArray) -> FloatArray:
    """Return samples at their places with those that were drawn between them."""
    filled = np.empty(samples.size + drawn.size)
    gaps = np.ones(filled.size, dtype=bool)
    gaps[at] = False
    filled[at], filled[gaps] = samples, drawn
    return filled


def _kept(block: Block, size: int) -> BoolArray | None:
    """Return which ordinates of a part to use: those that are no line of the block; None for all.

    A line's tail falls off with the distance in ordinates, which are wider apart in a part: so many
    times that its reach there is the root of so many times that of the block.
    """
    if block.kept is None:
        return None
    edges = np.flatnonzero(np.diff(np.concatenate([[True], block.kept, [True]]).astype(np.int8)))
    shrink = size / block.bins.n
    # Ordinates count from 1.
    middle = ((edges[::2] + edges[1::2]) / 2 + 0.5) * shrink
    reach = np.maximum((edges[1::2] - edges[::2]) / 2 * np.sqrt(shrink), _REACH)
    steps = np.zeros(size, dtype=np.int64)
    np.add.at(steps, np.clip(np.floor(middle - reach).astype(np.int64) - 1, 0, size - 1), 1)
    np.add.at(steps, np.clip(np.ceil(middle + reach).astype(np.int64), 0, size - 1), -1)
    kept: BoolArray = np.cumsum(steps)[: size - 1] == 0
    return kept


def _loss(block: Block, omega: FloatArray, missing: float) -> FloatArray:
    """Return the share of information lost: the block's at the same frequency, as the gaps are spread."""
    bins = block.bins
    share = missing * bins.n / block.drawn.size if block.drawn is not None else 0.0
    whole = np.zeros(bins.size) if block.loss is None else block.loss
    return np.clip(share * np.interp(omega, bins.omega, whole), 0.0, 0.99)

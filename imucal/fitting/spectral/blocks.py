"""AxisSeries -> blocks of ordinates: long gaps part the blocks, short ones are completed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from imucal.allan.dct import DctBins, dct_bins, fast_length, own_ordinates, ramp_ordinates
from imucal.arrays import BoolArray, FloatArray
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting.noise_fit import Line
from imucal.fitting.spectral.lines import find_lines, with_sines, without_strong_lines
from imucal.fitting.spectral.missing import complete
from imucal.fitting.spectral.regressors import regressor_ordinates
from imucal.recording import AxisSeries

#: Bends of a straight line, as a part of its steps: rounding, not noise.
_STRAIGHT = 1e-9
#: Fewest samples of a record and of a block.
_FEWEST = 64
#: A gap of more samples than this parts two blocks; a shorter one is completed.
_LONG = 64
#: Most blocks; the shorter ones of more long gaps are completed too.
_MOST = 48
#: Samples looked at at a time, so that they stay in the cache.
_PART = 1 << 16
#: Up to so many blocks have bins as fine as a record without gaps.
_FINE = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """The ordinates of one run of samples, in scaled units.

    Attributes
    ----------
    offset
        Place of its first sample on the clock's grid, from the first sample of the record.
    bins
        Their bins.
    ordinates
        X_k, shape (k,), from k = 1; as many as the bins hold.
    variance
        What missing samples add to the expected X_k², shape (k,); None for none.
    kept
        Which of them are used, shape (k,); None for all.
    loss
        Share of each bin's information that missing samples took, shape (b,); None for none.
    temperature
        At each place of the block, shape (bins.n,), or None.
    drawn
        The missing samples in order, drawn given the others, shape (g,); None for none.
    """

    offset: int
    bins: DctBins
    ordinates: FloatArray
    variance: FloatArray | None = None
    kept: BoolArray | None = None
    loss: FloatArray | None = None
    temperature: FloatArray | None = None
    drawn: FloatArray | None = None

    def regressor_parts(self, name: str) -> Callable[[slice], FloatArray]:
        """Return what gives parts of a regressor's ordinates; a ramp is never there as a whole."""
        if name == "R":
            return lambda part: ramp_ordinates(self.bins.n, part.stop - part.start, first=part.start + 1)
        return self.regressor(name).__getitem__

    def regressor(self, name: str) -> FloatArray:
        """Return the ordinates of a regressor, by its name."""
        return regressor_ordinates(
            name, self.bins.n, self.ordinates.size, offset=self.offset, temperature=self.temperature
        )

    def lowest(self, count: int) -> "Block":
        """Return the block of the lowest bins only, of at least `count` ordinates in all."""
        bins = self.bins
        number = int(np.searchsorted(bins.first, count, side="right"))
        stop = int(bins.first[number - 1] + bins.count[number - 1] - 1)
        stops = {"ordinates": stop, "variance": stop, "kept": stop, "loss": number}
        given = {name: end for name, end in stops.items() if getattr(self, name) is not None}
        return replace(
            self,
            bins=replace(
                bins, first=bins.first[:number], count=bins.count[:number], omega=bins.omega[:number]
            ),
            **{name: getattr(self, name)[:end] for name, end in given.items()},
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeriesBlocks:
    """All blocks of a record.

    Attributes
    ----------
    blocks
        In order of time.
    scale
        U per scaled unit, a power of two.
    lines
        Spectral lines that are left out, of the longest block.
    findings
        What making them showed.
    """

    blocks: tuple[Block, ...]
    scale: float
    lines: tuple[Line, ...]
    findings: tuple[Finding, ...]


def scale_of(series: AxisSeries) -> float:
    """Return a power of two near the size of the samples' steps, in U.

    Raises
    ------
    DataError
        If there are too few samples, all of them are equal, or they hold no noise beside a ramp.
    """
    samples = series.samples
    if samples.size < _FEWEST:
        msg = (
            f"{series.name}: {samples.size} samples, expected at least {_FEWEST} for a noise model; "
            "record for longer"
        )
        raise DataError(msg)
    largest = max(float(samples.max()), -float(samples.min()))
    square, bends = _steps_and_bends(samples, largest) if largest > 0 else (0.0, 0.0)
    size = float(np.sqrt(square)) * largest
    if not (np.isfinite(size) and size > 0):
        raise no_noise(series)
    if bends <= max(_STRAIGHT * size / largest, 8 * np.finfo(np.float64).eps):
        msg = (
            f"{series.name}: all {samples.size} samples lie on one straight line, expected noise; "
            "check that the column holds a measurement and not a counter"
        )
        raise DataError(msg)
    return float(2.0 ** np.round(np.log2(size)))


def no_noise(series: AxisSeries) -> DataError:
    """Return the error of an axis that never changes."""
    return DataError(
        f"{series.name}: all {series.n} samples are equal, expected noise; "
        "check that the sensor was on and that its resolution shows its noise"
    )


def _steps_and_bends(samples: FloatArray, largest: float) -> tuple[float, float]:
    """Return the mean square of the steps and the largest bend, of the samples over `largest`."""
    total = bends = 0.0
    for start in range(0, samples.size - 1, _PART):
        steps = np.diff(samples[start : start + _PART + 2] / largest)
        # The last step belongs to the next part, but where there is none.
        own = steps[:_PART]
        total += float(own @ own)
        bends = max(bends, float(np.max(np.abs(np.diff(steps)), initial=0.0)))
    return total / (samples.size - 1), bends


def make_blocks(series: AxisSeries, temperature: FloatArray | None = None) -> SeriesBlocks:
    """Return the ordinates of finite samples, gaps and lines taken care of.

    Raises
    ------
    DataError
        If there are too few samples, all of them are equal, or no run is long enough.
    """
    scale = scale_of(series)
    runs, lost = _runs(series)
    if not runs:
        msg = (
            f"{series.name}: no run of {_FEWEST} samples without a long gap among {series.n}; "
            "expected a recording that is mostly unbroken"
        )
        raise DataError(msg)
    blocks: list[Block] = []
    lines: tuple[Line, ...] = ()
    longest = 0
    for run in runs:
        quick = _quick(series, run)
        block = _transform(series, quick, _bins(quick.size, len(runs)), scale, temperature)
        ordinates, sines = without_strong_lines(block.ordinates, block.bins)
        kept, found = find_lines(ordinates, block.bins, scale=scale, rate_hz=series.rate_hz)
        blocks.append(replace(block, ordinates=ordinates, kept=kept))
        if block.bins.n > longest:
            lines, longest = with_sines(found, sines, scale=scale, rate_hz=series.rate_hz), block.bins.n
    return SeriesBlocks(
        blocks=tuple(blocks), scale=scale, lines=lines, findings=_gap_findings(series, runs, lost)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stretch:
    """Segments that make one block: samples[start:stop], from place `offset` for `size` places."""

    start: int
    stop: int
    offset: int
    size: int


def _runs(series: AxisSeries) -> tuple[list[_Stretch], int]:
    """Return the runs of segments between long gaps, and the number of samples in runs too short."""
    segments = series.clock.segments
    gaps = np.array([b.offset - a.offset - a.size for a, b in pairwise(segments)])
    order = np.argsort(-gaps, kind="stable")[: _MOST - 1] if gaps.size else np.zeros(0, dtype=np.int64)
    cuts = sorted(int(i) for i in order if gaps[i] > _LONG)
    runs, first = [], 0
    for cut in [*cuts, len(segments) - 1]:
        a, b = segments[first], segments[cut]
        size = b.offset + b.size - a.offset
        runs.append(_Stretch(start=a.start, stop=b.stop, offset=a.offset - segments[0].offset, size=size))
        first = cut + 1
    long = [run for run in runs if run.stop - run.start >= _FEWEST]
    return long, sum(run.stop - run.start for run in runs if run not in long)


def _quick(series: AxisSeries, run: _Stretch) -> _Stretch:
    """Return the run without the last few samples that would make its transform slow."""
    size = fast_length(run.size)
    if size == run.size:
        return run
    unbroken = run.stop - run.start == run.size
    places = None if unbroken else series.clock.grid()[run.start : run.stop] - run.offset
    kept = size if places is None else int(np.searchsorted(places, size))
    return replace(run, size=size, stop=run.start + kept)


def _bins(size: int, blocks: int) -> DctBins:
    """Return the bins of a block: fewer where there are many blocks, so that the whole stays small."""
    if blocks <= _FINE:
        return dct_bins(size)
    return dct_bins(size, singles=max(16, 512 // blocks), per_octave=max(10, 192 // blocks))


def _transform(
    series: AxisSeries, run: _Stretch, bins: DctBins, scale: float, temperature: FloatArray | None
) -> Block:
    samples = series.samples[run.start : run.stop]
    if temperature is not None:
        temperature = temperature[run.start : run.stop]
    variance = loss = drawn = None
    if samples.size == run.size:
        # A power of two scales the ordinates without a digit lost.
        ordinates = own_ordinates(samples)
        ordinates /= scale
    else:
        grid = series.clock.slice(run.start, run.stop).grid()
        seen = np.zeros(run.size, dtype=bool)
        seen[grid] = True
        full = np.zeros(run.size)
        full[grid] = samples
        full /= scale
        if temperature is not None:
            temperature = np.interp(np.arange(run.size), grid, temperature)
        del grid
        ordinates, variance, loss, drawn = complete(full, seen, bins)
    return Block(
        offset=run.offset,
        bins=bins,
        ordinates=ordinates,
        variance=variance,
        loss=loss,
        temperature=temperature,
        drawn=drawn,
    )


def _gap_findings(series: AxisSeries, runs: list[_Stretch], lost: int) -> tuple[Finding, ...]:
    completed = sum(run.size - (run.stop - run.start) for run in runs)
    if len(runs) == 1 and not completed and not lost:
        return ()
    parts = []
    if len(runs) > 1:
        parts.append(f"the likelihoods of {len(runs)} blocks between long gaps are multiplied")
    if completed:
        samples = "one missing sample" if completed == 1 else f"{completed} missing samples"
        verb = "is" if completed == 1 else "are"
        parts.append(
            f"{samples} in short gaps {verb} completed by {'its' if completed == 1 else 'their'} expectation"
        )
    if lost:
        parts.append(f"{lost} samples in runs shorter than {_FEWEST} are left out")
    return (
        Finding(
            level="info",
            code="gaps-in-fit",
            axis=series.name,
            text=f"The fit allows for gaps: {'; '.join(parts)}.",
        ),
    )

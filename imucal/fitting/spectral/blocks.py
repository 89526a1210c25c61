"""AxisSeries -> blocks of ordinates -> binned ordinates, and the bins that a result keeps.

Long gaps separate the blocks; short gaps are completed (`gaps`). Lines are left out. A record of many short
runs has many blocks; those of equal length have equal spectra, and their ordinates are summed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from imucal.allan.dct import DctBins, Transform, dct_bins, fast_length, run_ordinates
from imucal.allan.engine import refuse_tiny
from imucal.allan.variance import Run, runs_of
from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting.bins import Bins
from imucal.fitting.noise_fit import Line
from imucal.fitting.regressors import Ramp, Regressor, Stretch, parse
from imucal.fitting.spectral.disturbances.gaps import complete
from imucal.fitting.spectral.disturbances.lines import find_lines, with_sines, without_strong_lines
from imucal.fitting.spectral.ordinates import Ordinates, bin_shapes
from imucal.recording import AxisSeries

#: Regressors of a record without disturbances.
_RAMP = (Ramp(),)
#: Ratio of second to first differences below which there is no noise.
_STRAIGHT = 1e-9
#: Fewest samples of a record and of a block.
_MIN_SAMPLES = 64
#: Longest gap to complete; longer ones separate blocks.
_LONG = 64
#: Largest number of blocks; with more long gaps, shorter ones are completed too.
_MAX_BLOCKS = 48
#: Share of completed samples above which a fit is reported as uncertain, and above which runs end earlier.
_MANY_COMPLETED = 0.6
#: Gaps that are completed inside the runs of a log of trials: the largest that leaves few completed samples.
_BRIDGES = (64, 32, 16, 8, 4, 2, 1, 0)
#: Largest share of completed samples in the runs of a log of trials: then N is measured, not completed.
_FEW_COMPLETED = 0.2
#: Least share of the samples in the runs of a log of trials; with less, gaps are completed.
_ENOUGH = 0.5
#: Multiple of the mean gap up to which gaps are completed if a log has no runs: random losses exceed it in
#: one of 1e8 gaps.
_USUAL_GAPS = 20
#: Fewest samples of a run of a log of trials: with fewer, the subtracted means cost more than 6 % of N.
_MIN_TRIAL = 16
#: Largest number of runs of a log of trials: 1000 transforms take about 1 s.
_MAX_TRIALS = 1000
#: Largest number of lengths of trials; above it, runs are cut to lengths of a grid.
_MAX_LENGTHS = 24
#: Lengths per octave of that grid: a run loses 4 % of its samples on average.
_LENGTHS_PER_OCTAVE = 8
#: Samples processed at a time, to stay in the cache.
_PART = 1 << 16
#: Largest number of blocks with bins as fine as without gaps.
_FINE = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """The ordinates of one run of samples, in scaled units.

    `offset` is the place of its first sample on the clock's grid. The `ordinates` X_k, shape (k,), start at
    k = 1 and fill the `bins`. `variance`, shape (k,), is the part of the expected X_k² from missing samples,
    `loss`, shape (b,), each bin's share of information lost to them, and `drawn`, shape (g,), a draw of the
    missing samples; None if none is missing. `kept`, shape (k,), masks the ordinates in use, None for all.
    """

    offset: int
    bins: DctBins
    ordinates: FloatArray
    variance: FloatArray | None = None
    kept: BoolArray | None = None
    loss: FloatArray | None = None
    temperature: FloatArray | None = None
    drawn: FloatArray | None = None

    @property
    def stretch(self) -> Stretch:
        """The places of the samples, and their temperature."""
        return Stretch(n=self.bins.n, offset=self.offset, temperature=self.temperature)

    def parts_of(self, regressor: Regressor) -> Callable[[slice], FloatArray]:
        """Return a function that returns a part of a regressor's ordinates in this block."""
        return regressor.parts(self.stretch, self.ordinates.size)

    def ordinates_of(self, regressor: Regressor) -> FloatArray:
        """Return a regressor's ordinates in this block, shape (k,)."""
        return regressor.ordinates(self.stretch, self.ordinates.size)

    def lowest(self, count: int) -> "Block":
        """Return the block of the lowest bins only, of at least `count` ordinates in all."""
        bins = self.bins
        number = int(np.searchsorted(bins.first, count, side="right"))
        bins = replace(bins, **{name: getattr(bins, name)[:number] for name in ("first", "count", "omega")})
        stop = int(bins.first[-1] + bins.count[-1] - 1)
        stops = {"ordinates": stop, "variance": stop, "kept": stop, "loss": number}
        given = {name: end for name, end in stops.items() if getattr(self, name) is not None}
        return replace(self, bins=bins, **{name: getattr(self, name)[:end] for name, end in given.items()})


@dataclass(frozen=True, kw_only=True, eq=False)
class SeriesBlocks:
    """All blocks of a record, in order of time; `scale` is U per scaled unit.

    `lines` were left out of the longest block. `groups` are blocks of equal length whose ordinates are
    summed; if the record has no trials, each block is a group.
    """

    blocks: tuple[Block, ...]
    scale: float
    lines: tuple[Line, ...]
    findings: tuple[Finding, ...]
    groups: tuple[tuple[Block, ...], ...]
    #: Whether most samples were completed.
    sparse: bool = False

    def binned(self, regressors: Sequence[Regressor] = _RAMP) -> Ordinates:
        """Return the binned ordinates of all groups, with these regressors."""
        return Ordinates.joined(
            [_summed([_binned(block, self.scale, regressors) for block in group]) for group in self.groups]
        )


def scale_of(series: AxisSeries) -> float:
    """Return a power of two near the size of the samples' steps, in U.

    Too few samples, equal samples, and a ramp without noise raise a DataError.
    """
    samples = series.samples
    if samples.size < _MIN_SAMPLES:
        msg = f"{samples.size} samples, expected at least {_MIN_SAMPLES} for a noise model; record for longer"
        raise DataError(msg, place=series.name)
    size = size_of_steps(series)
    return float(2.0 ** np.round(np.log2(size)))


def size_of_steps(series: AxisSeries) -> float:
    """Return the root mean square of the steps between samples, in U.

    Equal samples, a ramp without noise, and values that are too small for a measurement raise a DataError.
    """
    samples = series.samples
    largest = max(float(samples.max()), -float(samples.min()))
    square, bends = _steps_and_bends(samples, largest) if largest > 0 else (0.0, 0.0)
    size = float(np.sqrt(square)) * largest
    if not (np.isfinite(size) and size > 0):
        raise no_noise(series)
    if bends <= max(_STRAIGHT * size / largest, 8 * np.finfo(np.float64).eps):
        msg = (
            f"all {samples.size} samples are on one straight line, expected noise; check that "
            "the column holds a measurement and not a counter"
        )
        raise DataError(msg, place=series.name)
    refuse_tiny(series)
    return size


def no_noise(series: AxisSeries) -> DataError:
    """Return the error of an axis that never changes."""
    return DataError(
        f"all {series.n} samples are equal, expected noise; "
        "check that the sensor was on and that its resolution shows its noise",
        place=series.name,
    )


def _steps_and_bends(samples: FloatArray, largest: float) -> tuple[float, float]:
    """Return mean square first and largest second difference of the samples divided by `largest`."""
    total = bends = 0.0
    for start in range(0, samples.size - 1, _PART):
        steps = np.diff(samples[start : start + _PART + 2] / largest)
        own = steps[:_PART]
        total += float(own @ own)
        bends = max(bends, float(np.max(np.abs(np.diff(steps)), initial=0.0)))
    return total / (samples.size - 1), bends


def make_blocks(
    series: AxisSeries, temperature: FloatArray | None = None, transform: Transform | None = None
) -> SeriesBlocks:
    """Return the ordinates of finite samples, with gaps completed and lines left out.

    `transform` is that of the samples; None computes it.
    Too few samples, equal samples, and no long enough run raise a DataError.
    """
    scale = scale_of(series)
    runs, trials = _runs(series)
    if not runs:
        msg = (
            f"no run of {_MIN_SAMPLES} samples without a long gap in {series.n} samples; "
            "expected a recording with few gaps"
        )
        raise DataError(msg, place=series.name)
    blocks: list[Block] = []
    lines: tuple[Line, ...] = ()
    longest = 0
    cut = _of_few_lengths(series, runs) if trials else [_quick(series, run) for run in runs]
    lengths = [run.end - run.first for run in cut]
    number = len(set(lengths)) if trials else len(runs)
    for run, length in zip(cut, lengths, strict=True):
        block = _transformed(series, run, _bins(length, number), scale, temperature, transform)
        ordinates, sines = without_strong_lines(block.ordinates, block.bins)
        kept, found = find_lines(ordinates, block.bins, scale=scale, rate_hz=series.rate_hz)
        blocks.append(replace(block, ordinates=ordinates, kept=kept))
        if block.bins.n > longest:
            lines, longest = with_sines(found, sines, scale=scale, rate_hz=series.rate_hz), block.bins.n
    groups: dict[int, list[Block]] = {}
    for place, block in enumerate(blocks):
        groups.setdefault(block.bins.n if trials else place, []).append(block)
    return SeriesBlocks(
        blocks=tuple(blocks),
        scale=scale,
        lines=lines,
        findings=_gap_findings(series, runs, trials=trials),
        groups=tuple(map(tuple, groups.values())),
        sparse=_completed_share(runs) > _MANY_COMPLETED,
    )


def _runs(series: AxisSeries) -> tuple[list[Run], bool]:
    """Return the runs between long gaps, and whether they are trials: short against the gaps.

    If most samples were completed, their expectations would determine the spectrum. Then runs end at shorter
    gaps too.
    """
    runs = _between_longest_gaps(series)
    if _completed_share(runs) <= _MANY_COMPLETED:
        return runs, False
    for bridging in _BRIDGES:
        trials = [run for run in runs_of(series.clock, bridging=bridging) if _count(run) >= _MIN_TRIAL]
        enough = sum(map(_count, trials)) >= max(_ENOUGH * series.n, _MIN_SAMPLES)
        if enough and _completed_share(trials) <= _FEW_COMPLETED:
            longest = sorted(trials, key=_count, reverse=True)[:_MAX_TRIALS]
            return sorted(longest), True
    # Losses without runs: gaps up to many times the mean one belong to them.
    usual = series.clock.missing / max(len(series.clock.segments), 1)
    return _between_longest_gaps(series, max(_LONG, round(_USUAL_GAPS * usual))), False


def _count(run: Run) -> int:
    return run.stop - run.start


def _completed(runs: Sequence[Run]) -> int:
    return sum(run.end - run.first - _count(run) for run in runs)


def _completed_share(runs: Sequence[Run]) -> float:
    return _completed(runs) / max(sum(run.end - run.first for run in runs), 1)


def _between_longest_gaps(series: AxisSeries, bridging: int = _LONG) -> list[Run]:
    every = runs_of(series.clock, bridging=bridging)
    gaps = [after.first - run.end for run, after in pairwise(every)]
    # Cut at the longest gaps; among equal ones, at the first.
    cuts = sorted(np.argsort(np.negative(gaps), kind="stable")[: _MAX_BLOCKS - 1].tolist())
    ends = zip([0, *(cut + 1 for cut in cuts)], [*cuts, len(every) - 1], strict=True)
    joined = [every[a]._replace(stop=every[b].stop, end=every[b].end) for a, b in ends]
    return [run for run in joined if _count(run) >= _MIN_SAMPLES]


def _of_few_lengths(series: AxisSeries, runs: list[Run]) -> list[Run]:
    """Return the runs, cut to few lengths if they have many."""
    sizes = np.array([run.end - run.first for run in runs])
    if np.unique(sizes).size <= _MAX_LENGTHS:
        return runs
    steps = np.arange(1 + _LENGTHS_PER_OCTAVE * int(np.ceil(np.log2(sizes.max() / _MIN_TRIAL))))
    grid = np.unique(np.floor(_MIN_TRIAL * 2 ** (steps / _LENGTHS_PER_OCTAVE)).astype(np.int64))
    chosen = grid[np.searchsorted(grid, sizes, side="right") - 1].tolist()
    ends = [run.first + size for run, size in zip(runs, chosen, strict=True)]
    return [
        run._replace(end=end, stop=series.clock.index_from(end)) for run, end in zip(runs, ends, strict=True)
    ]


def _quick(series: AxisSeries, run: Run) -> Run:
    """Return the run without the last few samples that would make its transform slow."""
    end = run.first + fast_length(run.end - run.first)
    return run if end == run.end else run._replace(end=end, stop=series.clock.index_from(end))


def _bins(size: int, blocks: int) -> DctBins:
    if blocks <= _FINE:
        return dct_bins(size)
    return dct_bins(size, singles=max(16, 512 // blocks), per_octave=max(10, 192 // blocks))


def _transformed(  # noqa: PLR0917 - a step of `make_blocks`
    series: AxisSeries,
    run: Run,
    bins: DctBins,
    scale: float,
    temperature: FloatArray | None,
    transform: Transform | None,
) -> Block:
    samples = series.samples[run.start : run.stop]
    if temperature is not None:
        temperature = temperature[run.start : run.stop]
    variance = loss = drawn = None
    if samples.size == bins.n:
        # Exact, because `scale` is a power of two.
        ordinates = run_ordinates(series.samples, run.start, samples.size, transform) / scale
    else:
        grid = series.clock.grid(run.start, run.stop) - run.first
        seen = np.zeros(bins.n, dtype=bool)
        seen[grid] = True
        full = np.zeros(bins.n)
        full[grid] = samples
        full /= scale
        if temperature is not None:
            temperature = np.interp(np.arange(bins.n), grid, temperature)
        del grid
        ordinates, variance, loss, drawn = complete(full, seen, bins)
    return Block(
        offset=run.first,
        bins=bins,
        ordinates=ordinates,
        variance=variance,
        loss=loss,
        temperature=temperature,
        drawn=drawn,
    )


def _gap_findings(series: AxisSeries, runs: list[Run], *, trials: bool) -> tuple[Finding, ...]:
    completed = _completed(runs)
    lost = series.n - sum(map(_count, runs))
    if len(runs) == 1 and not completed and not lost:
        return ()
    parts = []
    if len(runs) > 1:
        parts.append(f"the likelihoods of {len(runs)} blocks between long gaps are multiplied")
    if completed == 1:
        parts.append("one missing sample in short gaps is replaced by its expected value")
    elif completed:
        parts.append(f"{completed} missing samples in short gaps are replaced by their expected values")
    if lost:
        shortest = _MIN_TRIAL if trials else _MIN_SAMPLES
        parts.append(f"{lost} samples in runs shorter than {shortest} are left out")
    text = f"The fit allows for gaps: {'; '.join(parts)}."
    share = completed / max(sum(run.end - run.first for run in runs), 1)
    if share <= _MANY_COMPLETED:
        return (Finding("info", "gaps-in-fit", text, axis=series.name),)
    text += (
        f" These are {100 * share:.0f} % of the samples: the fit can tell white noise, flicker and random "
        "walk, but no filter, vibration or tone."
    )
    advice = "Record without losses, or use a part of the log with fewer."
    return (Finding("warning", "gaps-in-fit", text, advice, axis=series.name),)


#: Fields of the ordinates that a result keeps.
_KEPT = ("size", "power", "cross", "gram")
#: Fields of the ordinates that are sums over ordinates.
_SUMMED = ("size", "power", "cross", "gram")
#: Square of the relative rounding error of a transform.
_ROUNDING = 1e-28


def bin_blocks(blocks: Sequence[Block], scale: float, regressors: Sequence[Regressor] = _RAMP) -> Ordinates:
    """Return the binned ordinates of all blocks, with these regressors."""
    return Ordinates.joined([_binned(block, scale, regressors) for block in blocks])


def _summed(parts: Sequence[Ordinates]) -> Ordinates:
    """Return the ordinates of blocks of equal length as if of one; the sums of a likelihood are additive."""
    if len(parts) == 1:
        return parts[0]
    sums = {name: np.sum([getattr(part, name) for part in parts], axis=0) for name in _SUMMED}
    return replace(parts[0], **sums)


def _binned(block: Block, scale: float, regressors: Sequence[Regressor]) -> Ordinates:
    bins = block.bins
    vectors = [block.parts_of(regressor) for regressor in regressors]
    number = len(regressors)
    size, power = np.empty((2, bins.size))
    cross = np.empty((number, bins.size))
    gram = np.empty((number, number, bins.size))
    whole = 0.0
    for here, seen, starts in bins.parts():
        kept = None if block.kept is None else block.kept[seen]

        def total(values: FloatArray, kept: BoolArray | None = kept, starts: IntArray = starts) -> FloatArray:
            return np.asarray(np.add.reduceat(values if kept is None else values * kept, starts))

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
    # Add the transform's rounding error, so that no power is zero.
    power += _ROUNDING * whole / block.ordinates.size * size
    if block.loss is not None:
        # A single bin scatters as if it had 1 - loss of its ordinates, an octave as if it had the square.
        keep = np.square(1 - block.loss)
        size, power, cross, gram = size * keep, power * keep, cross * keep, gram * keep
    return Ordinates(
        scale=scale,
        regressors=tuple(regressors),
        size=size,
        power=power,
        cross=cross,
        gram=gram,
        **bin_shapes(bins),
    )


def bins_of(whole: Ordinates, blocks: SeriesBlocks, *, tau0: float, widening: float) -> Bins:
    """Return the bins of the groups of `blocks` to keep with a result."""
    every = [group[0].bins for group in blocks.groups]
    return Bins(
        n=np.array([bins.n for bins in every], dtype=np.int64),
        start=np.cumsum([0, *(bins.size for bins in every[:-1])]),
        first=np.concatenate([bins.first for bins in every]),
        scale=blocks.scale,
        tau0=tau0,
        widening=widening,
        names=whole.names,
        **{name: getattr(whole, name) for name in _KEPT},
    )


def ordinates_of(bins: Bins) -> Ordinates:
    """Return the ordinates that `bins` were made of, bit for bit; an unknown regressor is a DataError."""
    shapes = []
    for n, first in zip(bins.n.tolist(), np.split(bins.first, bins.start[1:]), strict=True):
        count = np.diff(first, append=n)
        omega = np.pi * (first + (count - 1) / 2) / n
        shapes.append(bin_shapes(DctBins(n=n, first=first, count=count, omega=omega)))
    joint: dict[str, Any] = {name: np.concatenate([s[name] for s in shapes], axis=-1) for name in shapes[0]}
    stored = {name: getattr(bins, name) for name in ("scale", *_KEPT)}
    return Ordinates(regressors=tuple(map(parse, bins.names)), **joint, **stored)

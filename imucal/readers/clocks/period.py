"""Estimate the sampling period tau from stamps t[k] by comparing two explanations.

If samples are *late* (in batches, or coarse ticks), t[k] - k tau stays bounded, and tau is the mean step.
If samples are *missing*, steps are multiples of tau, and t[k] - k (mean step) is a random walk, because
losses are independent. The von Neumann ratio of t[k] - k (mean step) decides: it is 2 for independent
lateness, and 0 for a random walk. Each batch contributes one stamp, with its first or last sample.
"""

from dataclasses import replace
from itertools import product, repeat

import numpy as np

from imucal.arrays import FloatArray, IntArray, blocks, median, percentile
from imucal.errors import ChoiceError
from imucal.frozen import frozen
from imucal.readers.fixes import GIVE_RATE

#: Number of runs examined, spread over the log.
_RUNS = 10
#: Samples in each run; logs that are shorter than all runs are examined completely.
_RUN = 4096
#: Plausible rates of IMUs, in Hz.
RATES = (1.0, 20_000.0)
#: Rates of nearly all logs of MEMS IMUs, in Hz: if one of two readings of a clock gives such a rate, it is
#: right.
LIKELY_RATES = (10.0, 2_000.0)
#: Relative difference of equal slopes.
_SAME = 0.03
#: Steps in a mean step: much longer than batches of up to 128 samples.
_WINDOW = 512
#: Most batches between the anchors of a slope.
_MAX_BATCHES = 64
#: Longest batch in samples: FIFOs of sensors hold at most 512.
_MAX_BURST = 512
#: Longest step within a batch, in ns: a bus delivers the samples of a FIFO faster.
_MAX_BURST_STEP = 2_000_000
#: Last stamp or first, and last sample or first.
_READ = ((True, True), (False, False), (False, True))
#: Least white jitter, in periods, that hides missing samples.
_MIN_JITTER = 0.1
#: Least share of steps within half a usual step of the usual one: with fewer there is no usual step.
_MIN_NEAR_SHARE = 0.55
#: Fewest stamps of a run whose phases are averaged.
_MIN_STAMPS = 256
#: Most stamps of a run whose phases are averaged: over more, the period must be known too exactly.
_MAX_STAMPS = 2048
#: Least mean length of the phases' unit vectors, in addition to chance, at the right period.
_MIN_COHERENCE = 0.12
#: At a smaller ratio of mean step to period, losses are too few to matter.
_MIN_LOST_RATIO = 1.003
#: Shortest pause between trials, in usual steps.
_MIN_PAUSE = 4
#: Fewest samples of a trial that shows the period.
_MIN_TRIAL = 8
#: Fewest pauses of a log of trials.
_MIN_PAUSES = 3
#: Fewest batches that show a period of their own.
_MIN_BATCHES = 6
#: Highest rate, in Hz, at which steps inside a batch may be those of a sensor.
_MAX_SENSOR_RATE = 2000.0
#: Largest share of losses explained by a nominal period in batches.
_MAX_NOMINAL_LOSS = 0.1
#: Above this share of losses, steps inside a batch are too short for a sensor.
_MAX_MISSING = 0.55
#: Most samples in a cycle of losses.
_MAX_CYCLE = 128
#: Fewest cycles of losses: fewer may be chance.
_MIN_CYCLES = 16
#: Most losses per sample of a cycle.
_MAX_LOSS = 0.6
#: Relative tolerance of a step that jitter changes.
_LOOSE = 0.2
#: Relative tolerance of a long step about a whole number of periods.
_WHOLE = 0.08
#: Relative difference of equal periods of a clock with coarse ticks.
_EXACT = 1e-3
#: Stamps per piece when ticks are removed.
_LOOK = 4096
REACH = 1 << 13
#: Samples per block, which fits the processor's cache.
BLOCK = 1 << 16


@frozen
class Period:
    """A first estimate of the sampling period, with the explanation of the stamps."""

    #: Period in ns, within about 1 %.
    tau_ns: float
    #: Standard deviation of a stamp about its neighbours, in samples.
    jitter: float = 0.0
    #: Greatest common divisor of the steps, in ns.
    resolution_ns: int = 1
    burst: int = 1
    #: Whether a batch is anchored at its last stamp, and at its last sample (otherwise the first).
    last_stamp: bool = True
    last_place: bool = True
    #: Longest step within a batch, in ns.
    pause_ns: float = 0.0
    #: Median step in ns; regular if most steps are within 5 % of it.
    usual_ns: float = 0.0
    regular: bool = False
    #: Largest lateness in samples: the range for batches, the tick for a coarse clock.
    loose: float = 0.0
    #: False if batches leave their places, so that the stamps are unexplained.
    bounded: bool = True
    #: Whether the period is from the stamps' phases, which losses do not change.
    coherent: bool = False
    #: Tick of a clock slightly shorter than the period; otherwise 0.
    tick_ns: float = 0.0
    #: Another period that fits equally well; otherwise 0.
    other_ns: float = 0.0
    trials: bool = False

    @property
    def free(self) -> bool:
        """Whether gaps may be fractions of a period."""
        return self.trials or self.burst > 1

    @property
    def rate_hz(self) -> float:
        return 1e9 / self.tau_ns


def estimate_period(stamps: IntArray, rate_hz: float | None = None) -> Period | None:
    """Return the sampling period of stamps in ns, shape (n,); None if they do not advance.

    Raises ChoiceError if `rate_hz` is needed to choose between late samples and mostly missing ones.
    """
    runs = every = _runs(stamps)
    steps = np.concatenate([np.diff(run) for run in runs])
    positive = steps[steps > 0]
    wide = _mean_step(runs)
    if not positive.size or not wide > 0:
        return None
    quantum = _quantum(steps)
    late, conserved = _late(runs, steps, wide, quantum)
    trials, other = _trials(runs, late, rate_hz)
    if trials:
        runs = trials
        steps = np.concatenate([np.diff(run) for run in runs])
        positive, wide = steps[steps > 0], _mean_step(runs)
        late, conserved = _late(runs, steps, wide, quantum)
    late = replace(late, other_ns=other, trials=bool(trials))
    chosen = late if other else _reading(runs, late, wide, quantum, rate_hz, conserved=conserved)
    chosen = _or_cycle(chosen, every, quantum, rate_hz)
    reach = 0.5 if chosen.coherent else 0.25
    near = (
        steps if chosen is late or chosen.tick_ns else positive[np.abs(positive / chosen.tau_ns - 1) < reach]
    )
    # The median absolute deviation ignores outliers.
    deviation = 1.4826 * median(np.abs(near - median(near))) / np.sqrt(2) if near.size else 0.0
    usual = median(steps)
    return replace(
        chosen,
        jitter=0.0 if chosen.tick_ns else float(deviation / chosen.tau_ns),
        resolution_ns=quantum,
        usual_ns=usual,
        regular=not chosen.tick_ns and bool(np.mean(np.abs(steps - usual) < 0.05 * usual) > 0.6),
    )


def _reading(
    runs: list[IntArray], late: Period, wide: float, quantum: int, rate_hz: float | None, *, conserved: bool
) -> Period:
    steps = np.concatenate([np.diff(run) for run in runs])
    positive = steps[steps > 0]
    unit = median(positive[positive <= 1.5 * percentile(positive, 10)])
    if unit >= (1 - _SAME) * late.tau_ns:
        return late
    ticks = _of_ticks(runs, steps, unit, quantum, rate_hz)
    if ticks is not None:
        return ticks
    missing = _of_phases(runs, steps, wide, quantum, conserved=conserved)
    if missing is None and (unit := _whole_unit(positive, unit)):
        missing = Period(tau_ns=unit, trials=late.trials)
    if missing is None:
        return late
    longer = positive[positive > 1.4 * missing.tau_ns]
    paused = bool(median(longer) >= 4 * missing.tau_ns)
    return _chosen(late, missing, rate_hz, conserved=conserved, paused=paused, pauses=longer.size)


def _quantum(steps: IntArray) -> int:
    """Ignore float errors of stamps in whole us."""
    some = steps[:100_000]
    whole = 1000 * np.rint(some / 1000).astype(np.int64)
    return int(np.gcd.reduce(np.abs(whole if whole.any() and np.abs(some - whole).max() <= 250 else some)))


def _trials(runs: list[IntArray], late: Period, rate_hz: float | None) -> tuple[list[IntArray], float]:
    """Return the runs without pauses between trials (empty without trials), and a period inside batches.

    The period is in ns, or 0. Raises ChoiceError if both explanations fit.
    """
    steps = np.concatenate([np.diff(run) for run in runs])
    usual = median(steps)
    pieces = _pieces(runs, _MIN_PAUSE * usual)
    if len(pieces) - len(runs) < _MIN_PAUSES:
        return [], 0.0
    inside = sum(map(len, pieces))
    own = sum(int(piece[-1] - piece[0]) for piece in pieces) / (inside - len(pieces))
    # If samples are missing everywhere, pauses are longer losses.
    if inside < 0.9 * sum(map(len, runs)) or own > 1.1 * usual or own < 1e9 / RATES[1]:
        return [], 0.0
    size = inside / len(pieces)
    beat, uneven, starts = _beat(runs, _MIN_PAUSE * usual, size)
    missing, batches = Period(tau_ns=own), Period(tau_ns=beat or late.tau_ns, burst=round(size))
    pauses = steps[steps > _MIN_PAUSE * usual] / own
    if rate_hz is not None:
        return pieces if _nearest(batches, missing, rate_hz) is missing else [], 0.0
    if _are_apart(missing, batches, pauses, uneven):
        return pieces, 0.0
    if not 1e9 / _MAX_SENSOR_RATE < own < (1 - _MAX_MISSING) * batches.tau_ns:
        return [], 0.0
    if own > _MAX_BURST_STEP or uneven > 1 or starts < _MIN_BATCHES:
        raise _two_readings(missing, batches)
    return [], own


def _are_apart(missing: Period, batches: Period, pauses: FloatArray, uneven: float) -> bool:
    """Return whether pauses, in periods, separate trials rather than batches of a buffer."""
    share = 1 - missing.tau_ns / batches.tau_ns
    if share < _MAX_MISSING:
        return share > _MAX_NOMINAL_LOSS or median(np.abs(pauses - np.rint(pauses))) < 0.12
    odd = batches.burst > _MAX_BURST or batches.rate_hz < RATES[0]
    return odd or uneven > (1.0 if missing.tau_ns > _MAX_BURST_STEP else 1.5)


def _pieces(runs: list[IntArray], pause: float) -> list[IntArray]:
    if pause <= 0:
        return []
    cut = [np.split(run, np.flatnonzero(np.abs(np.diff(run)) > pause) + 1) for run in runs]
    return [piece for pieces in cut for piece in pieces if piece.size >= _MIN_TRIAL]


def _beat(runs: list[IntArray], pause: float, size: float) -> tuple[float, float, int]:
    """Return period (ns, 0 if unknown), unevenness and number of batches of about `size` samples.

    The unevenness of a buffer is about 1.
    """
    found = []
    for last_stamp, last_place in _READ:
        anchors = [_anchors(run, pause, last_stamp=last_stamp, last_place=last_place) for run in runs]
        beat = _slope_of(anchors)
        if not beat > 0:
            # Stamps of a damaged file may run backwards.
            continue
        late = [times / beat - places for times, places in anchors if times.size]
        spread = [float(np.ptp(_about_a_line(_without_jumps(one, 0.0)))) / size for one in late]
        if spread:
            found.append((median(np.array(spread)), beat, sum(one.size for one in late)))
    uneven, beat, starts = min(found, default=(0.0, 0.0, 0))
    return beat, uneven, starts


def _nearest(late: Period, missing: Period, rate_hz: float) -> Period:
    return min(late, missing, key=lambda reading: abs(np.log(reading.rate_hz / rate_hz)))


def _two_readings(missing: Period, late: Period) -> ChoiceError:
    share = 1 - missing.tau_ns / late.tau_ns
    batches = f"in batches of about {late.burst}" if late.burst > 1 else "with uneven time stamps"
    return ChoiceError(
        f"the time stamps fit two rates: {missing.rate_hz:.6g} Hz with {share:.0%} of the samples missing, "
        f"or {late.rate_hz:.6g} Hz {batches}; expected one",
        fix=GIVE_RATE,
    )


def _of_ticks(
    runs: list[IntArray], steps: IntArray, unit: float, quantum: int, rate_hz: float | None
) -> Period | None:
    """Return the period of samples stamped by a clock with ticks of `unit` ns; None if no such clock fits.

    The highest line in the spectrum of the occupied ticks is at the rate of steps of two ticks.
    """
    whole = np.rint(steps / unit)
    longer = whole[whole > 1]
    off = percentile(np.abs(steps - whole * unit), 99)
    if off > min(1.01 * quantum, 0.2 * unit) or not longer.size or median(longer) > 2:
        return None
    some = runs[:: max(len(runs) // 5, 1)]
    unit = float(np.sum(steps) / np.sum(whole))
    slips = [slip for run in some if (slip := _slips(np.rint(np.diff(run) / unit).astype(np.int64)))]
    if 2 * len(slips) <= len(some):
        return None
    share = median(np.array(slips))
    found = Period(tau_ns=unit / (1 - share), tick_ns=unit)
    between = np.concatenate([np.diff(np.flatnonzero(np.diff(run) > 1.5 * unit)) for run in runs])
    exact = unit * (1 + 1 / median(between))
    # A few uneven gains change the rate, but not the percentiles.
    if percentile(between, 5) < percentile(between, 95) or abs(exact / found.tau_ns - 1) > _EXACT:
        return found if rate_hz is None else _nearest(found, Period(tau_ns=unit), rate_hz)
    found = replace(found, tau_ns=exact)
    if rate_hz is not None:
        return _nearest(found, Period(tau_ns=unit), rate_hz)
    # A power of ten is more likely a clock's tick than a sensor's period.
    if np.log10(quantum) % 1 == 0:
        return replace(found, other_ns=unit)
    return Period(tau_ns=unit, other_ns=found.tau_ns)


def _or_cycle(found: Period, runs: list[IntArray], quantum: int, rate_hz: float | None) -> Period:
    cycles = [cycle for run in runs if (cycle := _cycle(run[: 4 * _LOOK], quantum)) is not None]
    if found.other_ns or 2 * len(cycles) <= len(runs):
        return found
    cycle = sorted(cycles, key=lambda each: each.tau_ns)[len(cycles) // 2]
    if abs(found.tau_ns / cycle.tau_ns - 1) < _SAME / 2 and cycle.jitter < _LOOSE:
        return found
    return cycle if rate_hz is None else _nearest(found, cycle, rate_hz)


def _cycle(stamps: IntArray, quantum: int) -> Period | None:
    """Return the period if the mean step at one place of a cycle is several times that at the others."""
    steps = np.diff(stamps).astype(np.float64)
    for size in range(2, min(_MAX_CYCLE, steps.size // _MIN_CYCLES) + 1):
        cycles = steps[: steps.size // size * size].reshape(-1, size)
        means = cycles.mean(axis=0)
        longest = int(np.argmax(means))
        usual = float(np.delete(means, longest).mean())
        periods = round(means[longest] / usual) if usual > (1 - _LOOSE) * quantum else 0
        if not 2 <= periods <= 1 + size * _MAX_LOSS or abs(means[longest] / usual / periods - 1) > _WHOLE:
            continue
        # Gaps and batches also change the means, but not in all cycles.
        half = len(cycles) // 2
        moves = np.abs(cycles[:half].mean(axis=0) - cycles[half:].mean(axis=0)).max()
        short = np.delete(cycles, longest, axis=1) / usual
        steady = moves < 0.5 * usual and median(cycles[:, longest]) > 1.5 * usual
        if steady and np.abs(short.mean(axis=0) - 1).max() < _LOOSE:
            tau, coarse = float(means.sum()) / (size - 1 + periods), quantum > (1 - _LOOSE) * usual
            other = float(means.mean()) if coarse and periods == 2 else 0.0
            return Period(tau_ns=tau, jitter=float(short.std()), coherent=True, other_ns=other)
    return None


def _slips(ticks: IntArray) -> float:
    """Return the share of empty ticks due to a period longer than the tick, from steps in ticks; or 0."""
    at = np.concatenate([[0], np.cumsum(ticks)])
    at = at[: np.searchsorted(at, _MAX_STAMPS)]
    n = int(at[-1]) + 1
    if at.size < _MIN_STAMPS // 2 or n == at.size or np.any(ticks[: at.size - 1] < 1):
        return 0.0
    taken = np.zeros(n)
    taken[at] = 1.0
    lost = 1 - at.size / n
    width = 4 << n.bit_length()
    lines = np.abs(np.fft.rfft(taken - taken.mean(), width))
    low, high = 4 * width // n, int(width * lost) + 2 * width // n
    if high <= low:
        return 0.0
    near = (low + int(np.argmax(lines[low:high]))) / width
    # With fewer neighbours in phase, all could be empty by chance.
    few = np.log(1e6 * n) / np.log(1 / lost)
    # Lines at multiples of the rate are nearly as high.
    for first in (near, near / 2, near / 3):
        # Phases may smear.
        rates = first + np.linspace(-0.2, 0.2, int(min(max(40, 1.6 / first), 160)) + 1) / n
        each = [_least_taken(rate * np.arange(n) % 1.0, taken, 0.6 * rate, few) for rate in rates.tolist()]
        shares = np.array(each)
        if shares.min() <= 0.1:
            return median(rates[shares == shares.min()])
    return 0.0


def _least_taken(phases: FloatArray, taken: FloatArray, width: float, few: float) -> float:
    """Return the least share of occupied ticks in any range of phases of length `width`."""
    order = np.argsort(phases)
    phases = phases[order]
    samples = np.concatenate([[0.0], np.cumsum(np.tile(taken[order], 2))])
    start = np.arange(phases.size)
    stop = np.searchsorted(np.concatenate([phases, phases + 1]), phases + width, side="right")
    many = stop - start >= max(few, 0.5 * width * phases.size)
    shares = (samples[stop] - samples[start])[many] / (stop - start)[many]
    return float(shares.min(initial=1.0))


def _of_phases(
    runs: list[IntArray], steps: IntArray, wide: float, quantum: int, *, conserved: bool
) -> Period | None:
    """Return the period from the phases of stamps with white jitter; None if the phases are incoherent.

    White jitter of s periods reduces the mean length of the phases to exp(-(2 pi s)²/2), however many samples
    are missing. If stamps stay near even places (`conserved`), the period is just below `wide`, in ns.
    """
    usual = median(steps)
    off = np.abs(steps - usual)
    if wide > 8 * usual:
        return None
    if max(_MIN_JITTER * usual, quantum) > 1.05 * median(off) or np.mean(2 * off < usual) < _MIN_NEAR_SHARE:
        return None
    least, found = wide / 1.05 if conserved else min(0.75 * usual, wide), []
    for run in runs:
        times = (run[:_MAX_STAMPS] - run[0]) / wide
        if times.size < _MIN_STAMPS or not 0 < times[-1] < 10 * times.size:
            return None
        low, high = 1.0, wide / least
        points = 2 * (high - low) * times[-1]
        for _ in range(2):
            rates = np.linspace(low, high, int(points) + 1)
            length = [abs(np.exp(2j * np.pi * one * times).mean()) for one in rates.tolist()]
            rate = float(rates[np.argmax(length)])
            low, high, points = rate - 0.5 / times[-1], rate + 0.5 / times[-1], 80
        if max(length) < _MIN_COHERENCE + 5 / np.sqrt(times.size):
            return None
        found.append(rate)
    rate = median(np.array(found))
    return Period(tau_ns=wide / rate, coherent=True) if rate > _MIN_LOST_RATIO else None


def _chosen(
    late: Period, missing: Period, rate_hz: float | None, *, conserved: bool, paused: bool, pauses: int
) -> Period:
    share = 1 - missing.tau_ns / late.tau_ns
    if rate_hz is not None:
        return _nearest(late, missing, rate_hz)
    if missing.coherent:
        return missing
    buffered = late.burst <= _MAX_BURST and missing.tau_ns <= _MAX_BURST_STEP
    if conserved and (buffered or share <= 0.5) and (paused or share > 0.5):
        return late
    if share <= 0.5 or pauses < 3 or late.burst > _MAX_BURST:
        return missing
    raise _two_readings(missing, late)


def _runs(stamps: IntArray) -> list[IntArray]:
    if stamps.size <= _RUNS * _RUN:
        return [stamps]
    starts = np.linspace(0, stamps.size - _RUN, _RUNS).astype(np.int64)
    return [stamps[start : start + _RUN] for start in starts.tolist()]


def _mean_step(runs: list[IntArray]) -> float:
    """Return the median of mean steps in ns; it ignores a few long gaps."""
    run = max(runs, key=len)
    width = max(min(_WINDOW, run.size // 8), 16)
    spans = [each[width:] - each[:-width] for each in runs if each.size > width] if run.size > 48 else []
    usual = median(np.concatenate(spans)) / width if spans else 0.0
    return usual if usual > 0 else (int(run[-1]) - int(run[0])) / max(run.size - 1, 1)


def _whole_unit(positive: IntArray, short: float) -> float:
    """Return the unit near the short step that longer steps are multiples of; otherwise 0."""
    units = short * np.linspace(0.9, 1.35, 91)
    some = positive[:: max(positive.size // 4000, 1)]
    unit = float(units[np.argmax([np.cos(2 * np.pi * some / unit).mean() for unit in units])])
    near = positive[np.abs(positive / unit - 1) < 0.25]
    if near.size < 0.3 * positive.size:
        return 0.0
    unit = float(near.mean())
    longer = positive[positive > 1.4 * unit] / unit
    if not longer.size:
        return 0.0
    whole, single = (np.cos(2 * np.pi * some).mean() for some in (longer, near / unit))
    return unit if whole > max(0.35 * single, 3 / np.sqrt(2 * longer.size)) else 0.0


def _late(runs: list[IntArray], steps: IntArray, wide: float, quantum: int) -> tuple[Period, bool]:
    """Return the period if no sample is missing, and whether stamps stay near their places."""
    if _bursty(steps, wide):
        return _batched(runs, steps, wide, quantum)
    tick = quantum / wide
    late = [(run - run[0]) / wide - np.arange(run.size) for run in runs]
    coarse = bool(tick > 0.5 and np.count_nonzero(steps == 0) > 2)
    if coarse and any(np.ptp(_about_a_line(run)) > 1.05 * tick for run in late):
        coarse = False
    return Period(tau_ns=wide, loose=tick if coarse else 0.0), _wander(late, tick)[0]


def _batched(runs: list[IntArray], steps: IntArray, wide: float, quantum: int) -> tuple[Period, bool]:
    """As `_late` for batches, with the anchor of least scatter."""
    best, least, bounded = Period(tau_ns=wide), np.inf, False
    # A batch ends at a longer step than those within it, and than the tick of a coarse clock.
    pauses = {(median(steps[steps < wide]) + wide) / 2, max(1.5 * quantum, wide)}
    for pause, (last_stamp, last_place) in product(sorted(pauses), _READ):
        anchors = [_anchors(run, pause, last_stamp=last_stamp, last_place=last_place) for run in runs]
        tau = _slope_of(anchors) or wide
        late = [times / tau - places for times, places in anchors]
        moves = np.abs(np.concatenate([np.diff(one) for one in late]))
        scatter = median(moves) if moves.size else np.inf
        if scatter < 0.9 * least:
            sizes = np.concatenate([np.diff(places) for _, places in anchors])
            least, (bounded, loose) = scatter, _wander(late, quantum / tau)
            best = Period(
                tau_ns=tau,
                burst=max(round(percentile(sizes, 75)), 2),
                last_stamp=last_stamp,
                last_place=last_place,
                pause_ns=pause,
                loose=max(loose if bounded else scatter, 1.0),
                bounded=bounded,
            )
    return best, bounded


def _bursty(steps: IntArray, wide: float) -> bool:
    """Return whether samples come in batches: white jitter would cause as many long steps as short ones."""
    pauses = np.count_nonzero(steps > 1.5 * wide)
    if pauses < max(3, steps.size / 5000) or np.mean(steps < 0) > 0.02:
        return False
    short = percentile(steps, 49) < (1 - _SAME) * wide
    return short or bool(np.mean(np.abs(steps / wide - 1) < 0.25) < 0.3)


def _edges(stamps: IntArray, pause: float) -> tuple[IntArray, IntArray]:
    cuts = np.flatnonzero(np.abs(np.diff(stamps)) > pause) + 1
    return np.concatenate([[0], cuts]), np.concatenate([cuts, [stamps.size]]) - 1


def _anchors(
    run: IntArray, pause: float, *, last_stamp: bool, last_place: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the read times of batches, in ns from the first, and the samples taken at those times."""
    first, last = _edges(run, pause)
    first, last = first[1:-1], last[1:-1]
    times, places = run[last if last_stamp else first], (last if last_place else first)
    return (times - times[:1]).astype(np.float64), (places - places[:1]).astype(np.float64)


def _slope_of(anchors: list[tuple[FloatArray, FloatArray]]) -> float:
    slopes = []
    for times, places in anchors:
        far = max(min(times.size // 8, _MAX_BATCHES), 1)
        slopes.append((times[far:] - times[:-far]) / (places[far:] - places[:-far]))
    every = np.concatenate(slopes)
    return median(every) if every.size else 0.0


def _wander(late: list[FloatArray], tick: float) -> tuple[bool, float]:
    """Return whether lateness in samples stays bounded (no sample is missing), and its range.

    A random walk of m steps about its line has m/15 times the variance of a step, rarely less than m/64.
    """
    ratios, ranges = [], []
    for run in map(_without_jumps, late, repeat(tick)):
        if run.size < 2:
            continue
        rest = _about_a_line(run)
        ranges.append(float(np.ptp(rest)))
        most = max(0.75, run.size / 64) * np.mean(np.diff(rest) ** 2)
        ratios.append(ranges[-1] <= 1.01 * tick + 0.5 or rest.var() <= most)
    return (median(ratios) > 0.5, median(ranges)) if ratios else (False, 0.0)


def _without_jumps(late: FloatArray, tick: float) -> FloatArray:
    moves = np.diff(late, prepend=0.0)
    if moves.size:
        moves[np.abs(moves) > 5 * percentile(np.abs(moves), 80) + tick + 0.5] = 0.0
    return np.cumsum(moves)


def _about_a_line(values: FloatArray) -> FloatArray:
    place = np.arange(values.size) - (values.size - 1) / 2
    rest = values - values.mean()
    squares = max(float(np.einsum("i,i", place, place)), 1.0)
    return np.asarray(rest - place * (float(np.einsum("i,i", place, rest)) / squares))


def evened(stamps: IntArray, period: Period) -> IntArray:
    """Return stamps with batches and coarse ticks replaced by the times of sampling."""
    if period.burst == 1 and not period.tick_ns:
        return stamps

    def of(part: slice) -> IntArray:
        start = max(part.start - REACH, 0)
        block = stamps[start : min(part.stop + REACH, stamps.size)]
        if period.tick_ns:
            return _without_ticks(block, period)[part.start - start : part.stop - start]
        first, last = _edges(block, period.pause_ns)
        sizes = last - first + 1
        times = block[last if period.last_stamp else first]
        places = last if period.last_place else first
        # Incomplete batches at the ends follow their neighbours, except after a gap.
        for end, near in ((0, 1), (-1, -2)) if times.size > 2 else ():
            follows = times[near] + round((places[end] - places[near]) * period.tau_ns)
            if abs(follows - times[end]) < 2 * period.burst * period.tau_ns:
                times[end] = follows
        behind = np.arange(block.size) - np.repeat(places, sizes)
        spread = np.repeat(times, sizes) + np.round(behind * period.tau_ns).astype(np.int64)
        return np.asarray(spread[part.start - start : part.stop - start])

    return np.concatenate([of(part) for part in blocks(stamps.size)])


def _without_ticks(stamps: IntArray, period: Period) -> IntArray:
    """Return stamps in ns on an even grid, shape (n,), from stamps rounded down to a tick."""
    cuts = np.flatnonzero(np.abs(np.diff(stamps)) > 64 * period.tau_ns) + 1
    cuts = np.unique(np.concatenate([cuts, np.arange(_LOOK, stamps.size - _LOOK // 2, _LOOK)]))
    even = []
    for piece in np.split(stamps, cuts.tolist()):
        places = (piece - piece[0]) / period.tau_ns
        phases = np.sort(places % 1.0)
        free = np.diff(phases, append=phases[0] + 1)
        at = int(np.argmax(free))
        first = phases[at] + free[at] / 2
        even.append(piece[0] + np.round((np.floor(places - first) + first + 0.5) * period.tau_ns))
    return np.concatenate(even).astype(np.int64)

"""Simulated clocks with the faults of sensors, drivers and loggers, and the true rate and samples.

Realistic faults: a sensor samples evenly, to parts in a million. Its samples wait in a buffer that is read
when it is full or when the computer is free, and are stamped one after another. Clocks count in ticks, wrap,
and are set. Messages are lost, repeated and swapped.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray

START = 1_700_000_000_000_000_000
SECOND, MS, US = 10**9, 10**6, 10**3

#: Sizes of the batches in which a buffer is read.
SIZES = (
    2,
    3,
    4,
    5,
    6,
    7,
    8,
    9,
    10,
    12,
    14,
    15,
    16,
    18,
    20,
    24,
    25,
    28,
    32,
    40,
    48,
    50,
    64,
    80,
    100,
    120,
    128,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Awkward:
    """Stamps in ns, in the order of the log, and the truth.

    Attributes
    ----------
    rate_hz
        Rate at which the sensor sampled.
    samples
        Number of each sample as counted by the sensor, shape (n,); a repeated sample appears twice.
    finding
        Code of an expected finding; empty for none.
    refused
        Whether the stamps are ambiguous, so that the user must give the rate.
    """

    stamps: IntArray
    rate_hz: float
    samples: IntArray
    finding: str = ""
    refused: bool = False


def _clock(rate: float, n: int) -> FloatArray:
    return np.arange(n, dtype=np.float64) * (SECOND / rate)


def _whole(times: FloatArray, tick: int = 1) -> IntArray:
    """Return times from the start in whole ticks of a clock."""
    return START // tick * tick + np.floor(times / tick).astype(np.int64) * tick


def fifo(
    rate: float, size: int, own_us: float, tick: int, *, seed: int = 0, n: int = 4000, anchor: str = "first"
) -> Awkward:
    """Return samples of a buffer that is read `size` at a time, stamped `own_us` after each other.

    With a `seed` each batch has a random size, from half of `size` to one and a half. The stamps of a batch
    start at the time of its first sample or of its last sample (when it was read), or end there.
    """
    tau, own = SECOND / rate, own_us * US
    sizes = np.full(n // size + 1, size)
    if seed:
        rng = np.random.default_rng(seed)
        sizes = rng.integers(max(size // 2, 1), max(3 * size // 2, 2) + 1, 2 * n // size + 9)
    edges = np.concatenate([[0], np.cumsum(sizes)])
    sample = np.arange(n)
    batch = np.searchsorted(edges, sample, side="right") - 1
    first, last = edges[batch], edges[batch + 1] - 1
    times = {
        "first": first * tau + (sample - first) * own,
        "read": last * tau + (sample - first) * own,
        "last": last * tau - (last - sample) * own,
    }[anchor]
    return Awkward(stamps=_whole(times, tick), rate_hz=rate, samples=sample, finding="bursts")


def lossy(
    rate: float, share: float, *, jitter: float = 0.0, seed: int = 3, n: int = 6000, **more: object
) -> Awkward:
    """Return samples with a random share lost one by one; the jitter is in periods."""
    rng = np.random.default_rng(seed)
    kept = rng.random(n) >= share
    kept[[0, -1]] = True
    times = _clock(rate, n) + rng.normal(0, jitter * SECOND / rate, n)
    return Awkward(stamps=_whole(times)[kept], rate_hz=rate, samples=np.flatnonzero(kept), **more)  # type: ignore[arg-type]


def bursty_loss(rate: float, *, n: int = 20_000, seed: int = 4) -> Awkward:
    """Return samples of a radio link: 5 % are lost, in runs of about ten."""
    rng = np.random.default_rng(seed)
    kept = np.ones(n, dtype=np.bool_)
    for at in np.flatnonzero(rng.random(n) < 0.005).tolist():
        kept[at : at + int(rng.geometric(0.1))] = False
    kept[[0, -1]] = True
    return Awkward(stamps=_whole(_clock(rate, n))[kept], rate_hz=rate, samples=np.flatnonzero(kept))


def even(rate: float, tick: int = 1, *, n: int = 6000, jitter: float = 0.0, finding: str = "") -> Awkward:
    """Return all samples, stamped by a clock that counts in ticks; the jitter is in periods."""
    noise = np.random.default_rng(5).normal(0, 1, n) * jitter * SECOND / rate
    return Awkward(
        stamps=_whole(_clock(rate, n) + noise, tick), rate_hz=rate, samples=np.arange(n), finding=finding
    )


def scheduled(rate: float, *, n: int = 8000, tick: int = 1, seed: int = 6) -> Awkward:
    """Return samples that a busy computer reads at random times, all waiting ones at once."""
    rng = np.random.default_rng(seed)
    times = _clock(rate, n)
    reads = np.cumsum(rng.exponential(4.0, 4 * n) + 0.5) * SECOND / rate
    at = np.searchsorted(reads, times)
    order = np.arange(n) - np.searchsorted(at, at)
    return Awkward(
        stamps=_whole(reads[at] + order * 30 * US, tick), rate_hz=rate, samples=np.arange(n), finding="bursts"
    )


def packets(rate: float, size: int, *, n: int = 8000, interval_ms: float = 7.5) -> Awkward:
    """Return samples of a radio link: each packet has one stamp, at the next interval of the link."""
    sample = np.arange(n)
    last = sample // size * size + size - 1
    times = np.ceil(last * (SECOND / rate) / (interval_ms * MS)) * interval_ms * MS
    return Awkward(stamps=_whole(times), rate_hz=rate, samples=sample, finding="bursts")


def changed(
    of: Callable[[IntArray], IntArray], rate: float = 200.0, n: int = 8000, finding: str = ""
) -> Awkward:
    """Return even samples with stamps that a function changes."""
    clock = even(rate, n=n)
    return Awkward(stamps=of(clock.stamps.copy()), rate_hz=rate, samples=clock.samples, finding=finding)


def repeated(every: int, rate: float = 200.0, n: int = 6000) -> Awkward:
    """Return samples of which some are repeated with the same stamp and the same values."""
    sample = np.sort(np.concatenate([np.arange(n), np.arange(5, n, every)]))
    return Awkward(
        stamps=even(rate, n=n).stamps[sample], rate_hz=rate, samples=sample, finding="duplicate-stamps"
    )


def _set(by: int) -> Callable[[IntArray], IntArray]:
    return lambda stamps: stamps + np.where(np.arange(stamps.size) >= stamps.size // 2, by, 0)


def _stalled(stamps: IntArray) -> IntArray:
    for at in range(500, stamps.size - 200, 900):
        stamps[at : at + 90] = stamps[at + 90] - np.arange(90)[::-1] * 20_000
    return stamps


def _swapped(stamps: IntArray) -> IntArray:
    stamps[100::50], stamps[101::50] = stamps[101::50].copy(), stamps[100::50].copy()
    return stamps


def _one_wrong(stamps: IntArray) -> IntArray:
    stamps[stamps.size // 3] += 10**12
    return stamps


def _some_zero(stamps: IntArray) -> IntArray:
    stamps[[7, 8, stamps.size // 2]] = 0
    return stamps


def _restarted(stamps: IntArray) -> IntArray:
    half = stamps.size // 2
    stamps -= START - SECOND
    stamps[half:] -= stamps[half] - SECOND
    return stamps


def _drifting(stamps: IntArray) -> IntArray:
    place = np.arange(stamps.size)
    return stamps + np.round(np.cumsum(5 * MS * 2e-5 * np.sin(place / 900))).astype(np.int64)


def _single(stamps: IntArray) -> IntArray:
    """Round the seconds to single precision; the resolution gets worse with every doubling."""
    since = (stamps - START) / SECOND + 100
    return np.round(since.astype(np.float32).astype(np.float64) * SECOND).astype(np.int64)


def stopped(rate: float, n: int = 4000, hours: float = 1.0) -> Awkward:
    """Return a log with a pause of one hour."""
    sample = np.concatenate([np.arange(n), np.arange(n) + round(hours * 3600 * rate)])
    return Awkward(
        stamps=START + np.round(sample * SECOND / rate).astype(np.int64), rate_hz=rate, samples=sample
    )


def throttled(rate: float, keep: int, of: int, n: int = 6000, **more: object) -> Awkward:
    """Return a topic that passes `keep` of every `of` samples."""
    sample = np.flatnonzero(np.arange(n) % of < keep)
    return Awkward(stamps=even(rate, n=n).stamps[sample], rate_hz=rate, samples=sample, **more)  # type: ignore[arg-type]


def interpolated(rate: float, camera: float, n: int = 6000) -> Awkward:
    """Return samples with additional interpolated samples at the stamps of a camera."""
    own = _clock(rate, n)
    other = np.arange(0.0013 * SECOND, own[-1], SECOND / camera)
    times = np.sort(np.concatenate([own, other]))
    return Awkward(
        stamps=_whole(times), rate_hz=(times.size - 1) / (times[-1] - times[0]) * SECOND,
        samples=np.arange(times.size), finding="uneven-stamps",
    )  # fmt: skip


def trials(
    rate: float,
    sizes: IntArray,
    pauses_s: FloatArray,
    *,
    jitter_ms: float = 0.0,
    tick: int = 1,
    seed: int = 7,
    finding: str = "",
) -> Awkward:
    """Return trials with sizes of shape (m,) and pauses after them in seconds, shape (m,).

    A trial starts at any time: pauses are not multiples of the period. `samples` has the nearest places.
    """
    trial = np.repeat(np.arange(sizes.size), sizes)
    first = np.cumsum(sizes) - sizes
    spans = (sizes - 1) * (SECOND / rate) + pauses_s * SECOND
    starts = np.cumsum(spans) - spans
    times = starts[trial] + (np.arange(trial.size) - first[trial]) * (SECOND / rate)
    noise = np.random.default_rng(seed).normal(0, jitter_ms * MS, times.size)
    samples = np.round(times * (rate / SECOND)).astype(np.int64)
    return Awkward(stamps=_whole(times + noise, tick), rate_hz=rate, samples=samples, finding=finding)


def coarse(rate: float, tick: float, *, n: int = 6000, lost: float = 0.0, seed: int = 8) -> Awkward:
    """Return samples with a share lost, stamped by a clock whose ticks in ns need not be integers."""
    kept = np.flatnonzero(np.random.default_rng(seed).random(n) >= lost)
    stamps = np.round(np.floor(kept * (SECOND / rate) / tick + 0.3) * tick).astype(np.int64)
    return Awkward(stamps=START + stamps, rate_hz=rate, samples=kept, finding="coarse-stamps")


def switched(first_hz: float, then_hz: float, *, n: int = 6000, share: float = 0.5) -> Awkward:
    """Return samples of a sensor that changes its rate after a share of them."""
    steps = np.where(np.arange(n) < share * n, SECOND / first_hz, SECOND / then_hz)
    return Awkward(stamps=_whole(np.cumsum(steps)), rate_hz=first_hz, samples=np.arange(n))


def fused(
    rate: float, *, n: int = 6000, share: float = 0.5, offset: float = 0.4, jitter: float = 0.02
) -> Awkward:
    """Return two sensors under one name; the second stops after a share of the log."""
    rng = np.random.default_rng(9)
    one = _clock(rate, n)
    two = _clock(rate * 1.0003, round(share * n)) + offset * SECOND / rate
    times = np.concatenate([one, two])
    times = np.sort(times + rng.normal(0, jitter * SECOND / rate, times.size))
    return Awkward(stamps=_whole(times), rate_hz=rate, samples=np.arange(times.size))


def kinds() -> Iterator[tuple[str, Awkward]]:
    """Yield the names and the clocks, without the buffers of `fifos`."""
    for rate in (50.0, 200.0, 1000.0):
        yield f"even {rate:g}", even(rate)
    for share in (0.001, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4):
        yield f"lost {share:g}", lossy(200.0, share)
    yield "lost 0.2, jitter 0.1", lossy(200.0, 0.2, jitter=0.1)
    yield "lost 0.05, jitter 0.02", lossy(400.0, 0.05, jitter=0.02)
    yield "lost 0.6", lossy(200.0, 0.6, refused=True)
    yield "a second in ten", throttled(200.0, 200, 2000, 40_000)
    yield "lost in runs", bursty_loss(200.0)
    yield "jitter 0.2", even(200.0, jitter=0.2)
    yield "jitter 0.2 in ms", even(100.0, MS, jitter=0.2)
    yield "jitter 0.5", even(200.0, jitter=0.5)
    yield "jitter 1.5", even(200.0, jitter=1.5, finding="uneven-stamps")
    yield "interpolated", interpolated(200.0, 19.3)
    for rate, tick in ((200.0, MS), (300.0, MS), (400.0, MS), (600.0, MS), (800.0, MS), (1600.0, MS)):
        yield f"{rate:g} Hz in ms", even(rate, tick)
    yield "104 Hz in 10 ms", even(104.0, 10 * MS)
    yield "100 Hz in s", even(100.0, SECOND)
    yield "50 Hz in s", even(50.0, SECOND, n=3000)
    yield "200 Hz in 15.625 ms", even(200.0, 15_625_000)
    yield "416 Hz in 1/32768 s", even(416.0, 30_518)
    yield "seconds in single precision", changed(_single)
    yield "read when there is time", scheduled(200.0)
    yield "read when there is time, in ms", scheduled(200.0, tick=MS)
    yield "packets of 4", packets(200.0, 4)
    yield "packets of 3", packets(104.0, 3, interval_ms=15.0)
    yield "stalls", changed(_stalled)
    yield "swapped", changed(_swapped, finding="stamps-out-of-order")
    yield "one stamp wrong", changed(_one_wrong)
    yield "some zero", changed(_some_zero, finding="zero-stamps")
    yield "restarted", changed(_restarted, finding="clock-jump")
    yield "drift", changed(_drifting)
    for name, by in (("an hour ahead", 3600 * SECOND), ("an hour back", -3600 * SECOND)):
        yield f"set {name}", changed(_set(by))
    yield "leap second", changed(_set(-SECOND), finding="clock-jump")
    yield "set 0.3 s ahead", changed(_set(300 * MS), finding="gaps")
    yield "all twice", repeated(1)
    yield "some twice", repeated(40)
    yield "stopped for an hour", stopped(200.0)
    yield "two of three", throttled(200.0, 2, 3, refused=True)
    yield "nine of ten", throttled(200.0, 9, 10, refused=True)
    yield "64 of 72", throttled(100.0, 64, 72)
    yield "half of the time", throttled(100.0, 500, 1000, 20_000)
    yield "12 of 16", throttled(100.0, 12, 16)
    for count, size, rate in ((300, 100, 50.0), (20, 25, 100.0), (8, 600, 200.0)):
        pauses = np.random.default_rng(count).uniform(1, 60, count)
        sizes = np.full(count, size)
        yield f"{count} trials of {size}", trials(rate, sizes, pauses, finding="gaps")
        yield f"{count} trials of {size}, jitter", trials(rate, sizes, pauses, jitter_ms=0.2, finding="gaps")
    for rate, ticks, lost in ((201.3, 4.0, 0.0), (98.7, 8.0, 0.0), (903.0, 1.0, 0.03), (337.0, 2.0, 0.01)):
        yield f"{rate:g} Hz in {ticks:g} ms, lost {lost:g}", coarse(rate, ticks * MS, lost=lost)
    yield "100 Hz in single precision after 20 h", coarse(100.0, SECOND / 128)
    yield "an eighth of it", throttled(200.0, 7, 8, refused=True)


def fifos(sizes: tuple[int, ...] = SIZES) -> Iterator[tuple[str, Awkward]]:
    """Yield buffers with different batch sizes, stamp intervals, clocks and anchors, fixed and random."""
    for number, size in enumerate(sizes):
        for own_us in (1.0, 10.0, 100.0, 1000.0):
            tick = (1, US, MS)[number % 3]
            rate = (100.0, 200.0, 104.0)[(number // 3) % 3]
            anchor = ("first", "read", "last")[(number // 2) % 3]
            for seed in (0, 7 + number):
                name = f"{size} at {rate:g} Hz, {own_us:g} us, in {tick} ns, {anchor}" + (
                    ", random" if seed else ""
                )
                yield name, fifo(rate, size, own_us, tick, seed=seed, anchor=anchor)

"""Pathologies of real sensors and loggers: coverage, and wrong numbers without a warning.

    python tests/benchmarks/pathologies.py 40 --seed 7001 [--only NAME] [--write docs/results/pathologies.md]

Each case draws records with N = 1e-4 rad/s/√Hz and mostly B = 3e-5 rad/s ("NB"; "white": N only), disturbs
them like a sensor or a logger, and fits them with the defaults. The flicker noise comes from FFT shaping,
not from imucal. A record is silently wrong if an interval of N, B or K misses the truth (of K = 0: if its
lower limit is above 0) without a warning or an error. Refused records have an error that lists two readings.
The script uses no other module of the tests, so that it runs with other versions of the package too.
"""

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, iirnotch, lfilter, medfilt

import imucal
from imucal.errors import ImucalError
from imucal.readers.clocks import clock_from_stamps
from imucal.recording import Axis, Source
from imucal.screening import screen_values

Samples = npt.NDArray[Any]
N, B = 1e-4, 3e-5


@dataclass(frozen=True, kw_only=True)
class Record:
    """Samples, their stamps if a clock is estimated, and the truth."""

    samples: Samples
    rate_hz: float
    stamps_s: Samples | None = None
    flicker: float = B
    walk: float = 0.0
    white: float = N
    method: str = "mle"
    #: Samples of two more axes, if the finding is about a sensor.
    others: tuple[Samples, ...] = ()
    #: Temperatures in degrees Celsius at the samples, if the log contains them.
    temperature: Samples | None = None
    #: Whether the finding is one of the screening, which a fit of one axis omits.
    screened: bool = False


@dataclass(kw_only=True)
class Tally:
    """Outcomes of the records of a case."""

    n: int = 0
    b: int = 0
    false_k: int = 0
    silent: int = 0
    refused: int = 0
    records: int = 0
    seconds: float = 0.0
    codes: Counter[str] = field(default_factory=Counter)


Case = Callable[[np.random.Generator], Record]
CASES: dict[str, Case] = {}


def flicker(n: int, rng: np.random.Generator, rate_hz: float, size: float) -> Samples:
    """Return flicker noise of two-sided density B²/(2 pi f), from white noise shaped by an FFT."""
    frequency = np.fft.rfftfreq(2 * n, 1 / rate_hz)
    frequency[0] = frequency[1]
    white = np.fft.rfft(rng.standard_normal(2 * n)) * np.sqrt(rate_hz)
    return np.asarray(np.fft.irfft(white * np.sqrt(size**2 / (2 * np.pi * frequency)), 2 * n)[:n])


def noise(rng: np.random.Generator, rate_hz: float, n: int, size: float = B) -> Samples:
    """Return white noise, and flicker if it has a size."""
    white = N * np.sqrt(rate_hz) * rng.standard_normal(n)
    return np.asarray(white + flicker(n, rng, rate_hz, size) if size else white)


def case(name: str) -> Callable[[Case], Case]:
    def add(function: Case) -> Case:
        CASES[name] = function
        return function

    return add


def changed(
    name: str,
    change: Callable[[Samples, np.random.Generator], Samples],
    *,
    size: float = B,
    rate_hz: float = 100.0,
    n: int = 120_000,
    gain: float = 1.0,
    level: bool = False,
    axes: int = 1,
) -> None:
    """Add a case with changed samples and a correct clock.

    The change multiplies slow noise by `gain`. With `level` it also changes the density of white noise at low
    frequencies, which is N for an application that integrates samples: the truth is that of a long record.
    """

    def draw(rng: np.random.Generator) -> Record:
        each = [noise(rng, rate_hz, n, size) for _ in range(axes)]
        seed = rng.integers(1 << 32)
        samples, *others = (change(x, np.random.default_rng(seed)) for x in each)
        white = gain * N * (level_of(change) if level else 1.0)
        return Record(
            samples=samples, rate_hz=rate_hz, flicker=gain * size, white=white, others=tuple(others)
        )

    CASES[name] = draw


@cache
def level_of(change: Callable[[Samples, np.random.Generator], Samples]) -> float:
    """Return the factor by which a change multiplies the density of white noise at the lowest frequencies."""
    block, before, after = 250, [], []
    for seed in range(20):
        white = N * 10 * np.random.default_rng([911, seed]).standard_normal(400_000)
        changed = change(white, np.random.default_rng([912, seed]))
        before.append(white.reshape(-1, block).mean(axis=1))
        after.append(changed.reshape(-1, block).mean(axis=1))
    return float(np.std(after) / np.std(before))


def smooth(a: float) -> Callable[[Samples, object], Samples]:
    return lambda x, _: lfilter([a], [1, a - 1], x)


def rounded(change: Callable[[Samples, object], Samples], lsb: float) -> Callable[[Samples, object], Samples]:
    def both(x: Samples, rng: object) -> Samples:
        y = change(x, rng)
        step = lsb * y.std()
        return np.asarray(np.round(y / step) * step)

    return both


for kind, own in (("white", 0.0), ("NB", B)):
    for a in (0.3, 0.12, 0.095, 0.08, 0.05, 0.02):
        changed(f"1 smoothing a = {a}, {kind}", smooth(a), size=own)
changed("1 smoothing a = 0.05, LSB 1 sd", rounded(smooth(0.05), 1.0))
changed("1 smoothing a = 0.1, twice", lambda x, _: smooth(0.1)(smooth(0.1)(x, _), _))
changed("1 Butterworth 2 at 0.01", lambda x, _: lfilter(*butter(2, 0.01), x))
changed("1 moving average of 64", lambda x, _: np.convolve(x, np.ones(64) / 64, "valid"))


def warm_up(size: float, constant_s: float) -> Callable[[Samples, object], Samples]:
    return lambda x, _: x + size * np.exp(-np.arange(x.size) / 20 / constant_s)


for size, constant, hours, own in (
    *((1e-3, 120, 1, B), (1e-3, 1200, 1, B), (1e-3, 600, 1 / 3, B), (3e-4, 360, 1, B)),
    *((3e-4, 900, 1, B), (3e-4, 1200, 1, 0.0), (3e-4, 3600, 1, 0.0)),
):
    label = f"2 warm-up {size:g}, {constant / 60:g} min of {60 * hours:.0f}, {'NB' if own else 'white'}"
    changed(label, warm_up(size, constant), size=own, rate_hz=20.0, n=round(72_000 * hours))


def stamped(
    name: str,
    stamps: Callable[[Samples, np.random.Generator], tuple[Samples, Samples]],
    *,
    rate_hz: float,
    n: int = 60_000,
) -> None:
    """Add a case; `stamps` returns the mask of kept samples and their stamps in s."""

    def draw(rng: np.random.Generator) -> Record:
        keep, times = stamps(np.arange(n) / rate_hz, rng)
        return Record(samples=noise(rng, rate_hz, n)[keep], rate_hz=rate_hz, stamps_s=times)

    CASES[name] = draw


def ticks(
    tick_s: float, lost: float = 0.0
) -> Callable[[Samples, np.random.Generator], tuple[Samples, Samples]]:
    def stamps(t: Samples, rng: np.random.Generator) -> tuple[Samples, Samples]:
        keep = rng.random(t.size) >= lost
        return keep, np.floor((t[keep] + rng.random() * tick_s) / tick_s) * tick_s

    return stamps


def kept(
    rule: Callable[[Samples], Samples],
) -> Callable[[Samples, np.random.Generator], tuple[Samples, Samples]]:
    def stamps(t: Samples, _: np.random.Generator) -> tuple[Samples, Samples]:
        keep = rule(np.arange(t.size))
        return keep, t[keep]

    return stamps


def lost(share: float, burst: int = 1) -> Callable[[Samples, np.random.Generator], tuple[Samples, Samples]]:
    def stamps(t: Samples, rng: np.random.Generator) -> tuple[Samples, Samples]:
        gone = np.repeat(rng.random(t.size // burst + 1) < share, burst)[: t.size]
        return ~gone, t[~gone]

    return stamps


def trials(t: Samples, rng: np.random.Generator) -> tuple[Samples, Samples]:
    """Keep runs of 100 samples, with pauses of 300 to 2650 samples between them."""
    starts = np.cumsum(rng.integers(400, 2750, 1 + t.size // 400))
    keep = np.isin(np.arange(t.size), (starts[:, np.newaxis] + np.arange(100)).ravel())
    return keep, t[keep]


stamped("3 clock of 4 ms at 200 Hz", ticks(0.004), rate_hz=200.0)
stamped("3 clock of 8 ms at 100 Hz", ticks(0.008), rate_hz=100.0)
stamped("3 clock of 1 ms at 900 Hz, 2 % lost", ticks(0.001, 0.02), rate_hz=900.0)
stamped(
    "3 float32 seconds at 20 h, 200 Hz",
    lambda t, _: (np.ones(t.size, bool), (t + 72_000).astype(np.float32).astype(float)),
    rate_hz=200.0,
)
for share in (0.05, 0.1, 0.2, 0.3):
    stamped(f"4 lost one by one, {share:.0%}", lost(share), rate_hz=100.0)
stamped("4 lost in threes, 30%", lost(0.3, 3), rate_hz=100.0)
stamped("4 rate 100 to 50 Hz", kept(lambda k: (k < 30_000) | (k % 2 == 0)), rate_hz=100.0)
stamped("5 duty cycle of 5 s", kept(lambda k: k % 1000 < 500), rate_hz=100.0)
stamped("5 64 of 72", kept(lambda k: k % 72 < 64), rate_hz=100.0)
stamped("5 32 of 33", kept(lambda k: k % 33 < 32), rate_hz=100.0)
stamped("5 9 of 10", kept(lambda k: k % 10 < 9), rate_hz=100.0)
stamped("5 trials of 2 s, pauses of 6 to 53 s", kept(lambda k: k % 1500 < 100 + k // 1500 % 7), rate_hz=50.0)
stamped("5 300 trials of 2 s, pauses of 6 to 53 s", trials, rate_hz=50.0, n=500_000)
stamped("5 lost one by one, 92%", lost(0.92), rate_hz=100.0, n=200_000)
stamped("5 lost in tens, 92%", lost(0.92, 10), rate_hz=100.0, n=200_000)


def vibrating(
    low: float, high: float, times: float, order: int = 1
) -> Callable[[Samples, np.random.Generator], Samples]:
    def change(x: Samples, rng: np.random.Generator) -> Samples:
        return x + lfilter(*butter(order, (low, high), "band"), rng.standard_normal(x.size)) * times

    return change


for low, high, rate, n in ((0.01, 0.05, 20.0, 24_000), (0.01, 0.05, 200.0, 240_000)):
    for factor in (2, 5):
        band = vibrating(low, high, factor * N * np.sqrt(rate))
        label = f"6 hump {low * rate / 2:g}-{high * rate / 2:g} Hz, {factor**2} N²"
        changed(label, band, rate_hz=rate, n=n)


def cycle(periods: float) -> Callable[[Samples, np.random.Generator], Samples]:
    def change(x: Samples, rng: np.random.Generator) -> Samples:
        phase = 2 * np.pi * (periods * np.arange(x.size) / x.size + rng.random())
        return x + 1e-4 * np.cos(phase)

    return change


for periods in (1.0, 1.4):
    for own in (0.0, B):
        kind = "NB" if own else "white"
        changed(f"7 {periods:g} cycles in 24 h, {kind}", cycle(periods), size=own, rate_hz=1.0, n=86_400)


def interpolated(x: Samples, rng: np.random.Generator) -> Samples:
    places = np.arange(x.size)
    keep = places[rng.random(x.size) >= 0.05]
    return np.interp(places, keep, x[keep])


def outliers(share: float) -> Callable[[Samples, np.random.Generator], Samples]:
    def change(x: Samples, rng: np.random.Generator) -> Samples:
        return x + (rng.random(x.size) < share) * 6e-3 * rng.standard_normal(x.size)

    return change


def markov(time_s: float) -> Callable[[Samples, np.random.Generator], Samples]:
    def change(x: Samples, rng: np.random.Generator) -> Samples:
        a = np.exp(-1 / (100 * time_s))
        return x + lfilter([np.sqrt(1 - a * a) * 5e-5], [1, -a], rng.standard_normal(x.size))

    return change


changed("8 interpolated losses, 5 %", interpolated, level=True, axes=3)
changed("9 outliers of 6 sd, 1 %", outliers(0.01))
changed("9 outliers of 6 sd, 5 %", outliers(0.05))
changed("10 Gauss-Markov of 10 s", markov(10.0), size=0.0)
changed("10 Gauss-Markov of 50 s", markov(50.0), size=0.0)


@case("11 method gmwm, N + B + K")
def _gmwm(rng: np.random.Generator) -> Record:
    walk = 2e-5 * np.cumsum(rng.standard_normal(120_000)) / 10
    return Record(samples=noise(rng, 100.0, 120_000) + walk, rate_hz=100.0, walk=2e-5, method="gmwm")


@case("12 averaged to 1 Hz")
def _averaged(rng: np.random.Generator) -> Record:
    return Record(samples=noise(rng, 100.0, 360_000).reshape(-1, 100).mean(axis=1), rate_hz=1.0)


def shaped(x: Samples, rng: np.random.Generator) -> Samples:
    return np.asarray(x + np.diff(rng.standard_normal(x.size + 2), 2) * 3e-4)


def repeated(x: Samples, rng: np.random.Generator) -> Samples:
    last = np.maximum.accumulate(np.where(rng.random(x.size) < 0.2, 0, np.arange(x.size)))
    return np.asarray(x[last])


changed("13 sigma-delta, second order", shaped)
changed("13 20 % of the rows repeated", repeated, level=True, axes=3)
CASES["13 Student's t, 3 degrees"] = lambda rng: Record(
    samples=1e-3 / np.sqrt(3) * rng.standard_t(3, 120_000), rate_hz=100.0, flicker=0.0
)

# Twenty further cases.
_T = np.arange(120_000) / 100
changed("a tone that drifts by 1 Hz", lambda x, _: x + 1e-3 * np.sin(2 * np.pi * (20 * _T + 5e-4 * _T**2)))
CASES["b white noise that grows by 50 %"] = lambda rng: Record(
    samples=noise(rng, 100.0, 120_000, 0.0) * np.linspace(0.8, 1.2, 120_000), rate_hz=100.0, flicker=0.0
)
changed("c clipped at 3 sd", lambda x, _: np.clip(x, -3e-3, 3e-3), level=True)
changed("d dead band of half a sd", lambda x, _: np.where(np.abs(x) < 5e-4, 0.0, x), level=True)
changed("e notch at 20 Hz", lambda x, _: lfilter(*iirnotch(20, 3, 100), x))
changed("f high-pass at 1 mHz", lambda x, _: lfilter(*butter(1, 2e-5, "high"), x))
changed("g median of 3", lambda x, _: medfilt(x, 3), level=True)
changed("h rounded to 3 sd", lambda x, _: np.round(x / 3e-3) * 3e-3, level=True)
changed("i every 1000th sample off by 10 sd", lambda x, _: x + 1e-2 * (np.arange(x.size) % 1000 == 7))
changed("j parabola of 3e-4", lambda x, _: x + 3e-4 * np.linspace(-1, 1, x.size) ** 2)
CASES["k resampled from 100 to 90 Hz"] = lambda rng: Record(
    samples=np.interp(np.arange(0, 119_999, 10 / 9), np.arange(120_000), noise(rng, 100.0, 120_000)),
    rate_hz=90.0,
)
changed("l float16 with an offset of 1", lambda x, _: (x + 1).astype(np.float16).astype(float), level=True)
changed("m a step of 3e-4", lambda x, _: x + 3e-4 * (np.arange(x.size) > 70_000))
changed(
    "n echo of half, 5 samples late", lambda x, _: x + 0.5 * np.concatenate([np.zeros(5), x[:-5]]), gain=1.5
)
changed(
    "o fan from half on, 5-15 Hz",
    lambda x, r: x + vibrating(0.1, 0.3, 3e-3)(0 * x, r) * (np.arange(x.size) > 60_000),
)
changed("p two jumps that cancel", lambda x, _: x + 2e-4 * ((np.arange(x.size) // 40_000) == 1))
changed("q saw tooth of 1e-4, 3 min", lambda x, _: x + 1e-4 * (_T % 180 / 180))
changed("r sum of two one-poles", lambda x, r: smooth(0.3)(x, r) * 0.5 + smooth(0.05)(x, r) * 0.5)
stamped(
    "s jitter of 30 %", lambda t, r: (np.ones(t.size, bool), t + r.normal(0, 0.003, t.size)), rate_hz=100.0
)
stamped(
    "t clock 200 ppm fast, reset once",
    lambda t, _: (np.ones(t.size, bool), np.where(t > 300, t - 250, t) * 1.0002),
    rate_hz=100.0,
)

CASES["u two sensors in turn, the second with twice the noise"] = lambda rng: Record(
    samples=np.stack([noise(rng, 100.0, 60_000), 2 * noise(rng, 100.0, 60_000)], axis=1).ravel(),
    rate_hz=200.0,
    screened=True,
)


def torn(x: Samples, rng: np.random.Generator) -> Samples:
    """Return samples in steps of a 60th of the noise; 0.3 % have the high byte of the sample before."""
    step = N * 10 / 60
    counts = np.round(x / step).astype(int)
    high = np.roll(counts, 1) >> 8
    return np.asarray(np.where(rng.random(x.size) < 0.003, 256 * high + (counts & 255), counts) * step)


changed("w high-pass at 0.1 Hz", lambda x, _: lfilter(*butter(1, 2e-3, "high"), x))
changed("v torn 16-bit reads, 0.3 %", torn)

changed(
    "x smoothing a = 0.05, then white noise of 5 %",
    lambda x, r: smooth(0.05)(x, r) + 5e-5 * r.standard_normal(x.size),
    n=90_000,
)
for low, high, squared, n in ((2, 8, 0.25, 90_000), (2, 8, 0.5, 18_000), (0.5, 2, 0.5, 90_000)):
    band = vibrating(low / 50, high / 50, np.sqrt(squared) * N * 10, order=2)
    changed(f"x vibration of {low:g}-{high:g} Hz, {squared:g} N²", band, n=n)


def swaying(x: Samples, rng: np.random.Generator) -> Samples:
    """Return smoothed samples with a sway of 0.1 to 0.5 Hz of nine times the density."""
    return np.asarray(smooth(0.1)(x, rng) + vibrating(0.002, 0.01, 3e-3)(0 * x, rng))


def filtered_vibration(x: Samples, rng: np.random.Generator) -> Samples:
    """Return samples with a vibration of 1 to 3 Hz, both behind a low-pass filter of 20 Hz."""
    vibration = vibrating(0.01, 0.03, 3 * N * np.sqrt(200), order=2)(x, rng)
    return np.asarray(lfilter(*butter(2, 0.2), vibration))


changed("x smoothing a = 0.1 and sway of 0.1-0.5 Hz", swaying)
changed("x low-pass of 20 Hz and vibration of 1-3 Hz", filtered_vibration, rate_hz=200.0)


def moving_level(name: str, minutes: float, shape: Callable[[Samples], Samples]) -> None:
    """Add a case whose level changes by 2e-4 rad/s; `shape` is its share, from s after a random time."""

    def change(x: Samples, rng: np.random.Generator) -> Samples:
        begin = x.size / 20 * rng.uniform(0.25, 0.65)
        return x + 2e-4 * shape(np.arange(x.size) / 20 - begin)

    changed(name, change, rate_hz=20.0, n=round(minutes * 1200))


moving_level("x bump of 5 min in 1 h", 60, lambda t: np.exp(-0.5 * (t / 300) ** 2))
moving_level("x load switched on, lag 2 min, in 30 min", 30, lambda t: -np.expm1(-np.maximum(t, 0) / 120))
moving_level("x level moves within 10 min of 2 h", 120, lambda t: np.clip(t / 600, 0, 1))
moving_level("x level moves within 2 min of 1 h", 60, lambda t: np.clip(t / 120, 0, 1))


def conditioned(x: Samples, rng: np.random.Generator) -> Samples:
    """Return samples whose level follows an air conditioning: on and off for 4 to 16 minutes, lag 5 min."""
    turns = np.cumsum(rng.uniform(240, 960, 40) * 20).astype(int)
    on = np.searchsorted(turns, np.arange(x.size), side="right") % 2
    return np.asarray(x + 1e-4 * smooth(1 / 6000)(on.astype(float), rng))


changed("x irregular air conditioning", conditioned, rate_hz=20.0, n=144_000)


@case("x logged temperature explains the drift")
def _warming(rng: np.random.Generator) -> Record:
    t = np.arange(72_000) / 20
    degrees = 25 - 4 * np.expm1(-t / 900) + 0.4 * np.sin(2 * np.pi * t / 1300 + rng.uniform(0, 6))
    samples = noise(rng, 20.0, t.size) + 1e-4 * (degrees - 25)
    return Record(samples=samples, rate_hz=20.0, temperature=degrees)


@case("x averaged from 20 to 2 Hz, B = N")
def _averaged_to_2_hz(rng: np.random.Generator) -> Record:
    samples = noise(rng, 20.0, 300_000, 1e-4).reshape(-1, 10).mean(axis=1)
    return Record(samples=samples, rate_hz=2.0, flicker=1e-4)


@case("x averaged from 100 to 5 Hz, B = 2 N")
def _averaged_to_5_hz(rng: np.random.Generator) -> Record:
    samples = noise(rng, 100.0, 600_000, 2e-4).reshape(-1, 20).mean(axis=1)
    return Record(samples=samples, rate_hz=5.0, flicker=2e-4)


#: Introduction of the table.
_ABOUT = """`tests/benchmarks/pathologies.py` wrote this table.
"NB" has N and B, "white" has N only. A record is silently wrong if
an interval of N, B or K misses the truth without a warning or an error. Plain noise misses now and then too,
because three intervals of 95 % are looked at.

N is the density of the delivered samples at low frequencies. If a change of the samples, such as a median,
a dead band or interpolation, alters this density, the truth is measured on 8 million samples of white noise.

"""
#: Warnings that do not explain wrong numbers.
_NOT_NAMED = {"model-choice", "record-length", "gaps", "gaps-in-fit"}


def run(draw: Case, rng: np.random.Generator, tally: Tally) -> None:
    """Draw one record, fit it, and count."""
    record = draw(rng)
    tally.records += 1
    began = time.process_time()
    try:
        findings: tuple[Any, ...] = ()
        series = imucal.AxisSeries.from_samples(record.samples, rate_hz=record.rate_hz)
        if record.stamps_s is not None:
            read = clock_from_stamps(np.round(record.stamps_s * 1e9).astype(np.int64), source="stamps")
            samples = record.samples if read.order is None else record.samples[read.order]
            series = imucal.AxisSeries(
                sensor=series.sensor, axis=series.axis, samples=samples, clock=read.clock
            )
            findings = read.findings
        if record.others or record.screened:
            axes: tuple[Axis, ...] = ("y", "z")
            pairs = zip(axes, record.others, strict=False)
            others = [imucal.AxisSeries.from_samples(x, rate_hz=record.rate_hz, axis=a) for a, x in pairs]
            source = Source(path="drawn", format="csv")
            findings = screen_values(imucal.Recording(source=source, series=(series, *others)))
        fit = imucal.fit(series, method=record.method, temperature=record.temperature)
    except ImucalError:
        tally.refused += 1
        return
    finally:
        tally.seconds += time.process_time() - began
    findings = (*findings, *fit.findings)
    n, b, k = fit["N"], fit["B"], fit["K"]
    holds_n, holds_b = n.low <= record.white <= n.high, b.low <= record.flicker <= b.high
    false_k = k.low > 0 if not record.walk else not k.low <= record.walk <= k.high
    tally.n += holds_n
    tally.b += holds_b
    tally.false_k += false_k
    named = {f.code for f in findings if f.level != "info" and f.code not in _NOT_NAMED - {"gaps-in-fit"}}
    tally.codes.update({f.code for f in findings} - _NOT_NAMED)
    tally.silent += not (holds_n and holds_b and not false_k) and not named


def main() -> None:
    """Print the table, and write it on request."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("records", type=int, nargs="?", default=40)
    parser.add_argument("--seed", type=int, default=7001)
    parser.add_argument("--only", default="")
    parser.add_argument("--write", type=Path)
    arguments = parser.parse_args()
    lines = [
        f"{arguments.records} records a case, seed {arguments.seed}.",
        "",
        "| case | N holds | B holds | K wrong | refused | silently wrong | CPU s | findings |",
        "|---|---|---|---|---|---|---|---|",
    ]
    print("\n".join(lines), flush=True)
    total = Tally()
    for index, (name, draw) in enumerate(CASES.items()):
        if not name.startswith(arguments.only):
            continue
        tally = Tally()
        for number in range(arguments.records):
            run(draw, np.random.default_rng([arguments.seed, index, number]), tally)
        codes = ", ".join(f"{code} {count}" for code, count in tally.codes.most_common(4))
        cells = (name, tally.n, tally.b, tally.false_k, tally.refused, tally.silent)
        lines.append(f"| {' | '.join(map(str, cells))} | {tally.seconds / tally.records:.2f} | {codes} |")
        print(lines[-1], flush=True)
        total.silent += tally.silent
        total.records += tally.records
    lines += ["", f"Silently wrong: {total.silent} of {total.records} records."]
    print("\n".join(lines[-2:]))
    if arguments.write:
        title = "# What real sensors and loggers do\n\n" + _ABOUT
        arguments.write.write_text(title + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

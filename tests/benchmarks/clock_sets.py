"""Verdicts on ten sets of clocks with known truth: right, warned, asked or silently wrong.

    python -m tests.benchmarks.clock_sets --seed 7
    python -m tests.benchmarks.clock_sets --seed 7 --only common ticks --scale 0.25 --show asked silent

A rate is wrong if it is more than 0.5 % off, or if samples are left out. A clock is

- right: the rate is right, without a finding about the rate;
- warned: a finding about the rate, whether the rate is right or wrong;
- asked: an error that asks for the rate; "unnamed" if it does not contain the true rate;
- silent: the rate is wrong, and no finding explains it.

Each clock whose rate is asked or wrong is read again with the true rate. This must give all samples and no
finding that the stamps contradict the rate.
"""

import argparse
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import ImucalError
from imucal.readers.clocks import ClockReading, clock_from_stamps, repeats
from tests.benchmarks.clocks import drawn, pathology
from tests.benchmarks.pathologies import kept, lost, ticks
from tests.readers.clocks.awkward import MS, SECOND, START, US, Awkward, fifos, kinds

Draw = Callable[[np.random.Generator], tuple[str, Awkward]]

#: Largest relative error of a right rate: N is then 0.25 % off.
_MAX_OFF = 0.005
#: Findings about the rate.
_RATE_FINDINGS = {"two-readings", "uneven-stamps", "rate-changes", "extra-samples"}
VERDICTS = ("right", "warned, right", "warned, wrong", "warned, unnamed", "asked", "asked, unnamed", "silent")


def _stamped(times: NDArray[np.floating[Any]], tick: int) -> IntArray:
    return START + np.floor(times / tick).astype(np.int64) * tick


def _tick(rng: np.random.Generator) -> int:
    return int(rng.choice([1, US, MS]))


def _kept(rng: np.random.Generator, n: int, share: float) -> BoolArray:
    """Return which of n samples are kept if a share is lost; the first and the last are kept."""
    keep = rng.random(n) >= share
    keep[[0, -1]] = True
    return np.asarray(keep)


def common(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return a common log: jitter and losses up to 30 %, gaps, resets, joined files, float32, ms and us."""
    rate = float(rng.choice([20, 50, 100, 125, 200, 250, 400, 500, 1000]))
    if rng.random() < 0.7:
        rate *= 1 + rng.normal(0, 2e-3)
    n = int(rng.choice([600, 3000, 20_000, 60_000]))
    sample = np.arange(n)
    tau = SECOND / rate
    jitter = float(rng.choice([0, 0, 0.01, 0.05, 0.1, 0.2, 0.3]))
    share = float(rng.choice([0, 0, 0, 0.001, 0.01, 0.05, 0.2, 0.3]))
    if jitter >= 0.1 and rng.random() < 0.7:
        share = 0.0
    drift = rng.normal(0, 50e-6) * sample * sample / n * tau
    times = sample * tau + drift + rng.normal(0, 1, n) * jitter * tau
    keep = rng.random(n) >= share
    kind = str(rng.choice(["plain", "plain", "gap", "gaps", "reset", "files", "float32", "ms", "us"]))
    if kind == "gap":
        first = int(rng.integers(n // 4, n // 2))
        keep[first : first + int(rng.integers(1, n // 4))] = False
    if kind == "gaps":
        for first in rng.integers(0, n, n // 500 + 1).tolist():
            keep[first : first + int(rng.integers(1, 60))] = False
    if kind == "reset":
        first = int(rng.integers(n // 4, 3 * n // 4))
        times = np.where(sample >= first, times - times[first] + SECOND, times)
    if kind == "files":
        for first in np.sort(rng.integers(0, n, int(rng.integers(1, 6)))).tolist():
            times = np.where(sample >= first, times + rng.uniform(2, 4000) * SECOND, times)
    keep[[0, -1]] = True
    stamps = _stamped(times, {"ms": MS, "us": US}.get(kind, 1))
    if kind == "float32":
        seconds = (times / SECOND + rng.uniform(0, 500)).astype(np.float32)
        stamps = np.round(seconds.astype(np.float64) * SECOND).astype(np.int64)
    name = f"{kind}, {rate:.5g} Hz, jitter {jitter:g}, lost {share:g}, n {n}"
    return name, Awkward(stamps=stamps[keep], rate_hz=rate, samples=sample[keep])


def usb(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return USB or FIFO batches of 2 to 32 samples: even, random or late reads, frames of 1 ms."""
    rate = float(rng.choice([100, 125, 200, 250, 400, 500, 800, 1000])) * (1 + rng.normal(0, 3e-3))
    size = int(rng.integers(2, 33))
    n = int(rng.choice([3000, 10_000, 60_000]))
    tau = SECOND / rate
    own = min(float(rng.choice([0, 0, 20e3, 125e3])), 0.3 * tau)
    sample = np.arange(n)
    if rng.random() < 0.5:
        last = (sample // size + 1) * size - 1
    else:
        ends = np.cumsum(rng.integers(max(1, size // 2), 3 * size // 2 + 1, 2 * n))
        last = ends[np.searchsorted(ends, sample, side="right")] - 1
    kind = str(rng.choice(["read", "late", "frames"]))
    times = last * tau
    if kind == "late":
        times = times + rng.exponential(300e3, int(last.max()) + 1)[last]
    if kind == "frames":
        times = np.ceil((times + MS) / MS) * MS
    first = np.searchsorted(last, last)
    times = times + (sample - first) * own
    tick = _tick(rng)
    name = f"{size} of {rate:.5g} Hz, {own / US:.3g} us, tick {tick} ns, {kind}, n {n}"
    return name, Awkward(stamps=_stamped(times, tick), rate_hz=rate, samples=sample)


def queue(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return samples that wait for a single server, which is slow at random or stalls; some are lost."""
    rate = float(rng.choice([50, 100, 200, 400])) * (1 + rng.normal(0, 2e-3))
    n = int(rng.choice([3000, 20_000, 60_000]))
    tau = SECOND / rate
    load = rng.uniform(0.1, 0.9)
    kind = str(rng.choice(["exponential", "gamma", "stalls"]))
    if kind == "exponential":
        service = rng.exponential(load * tau, n)
    elif kind == "gamma":
        service = rng.gamma(0.3, load * tau / 0.3, n)
    else:
        service = np.where(rng.random(n) < 0.002, rng.uniform(1e7, 8e7, n), 0.05 * tau)
    # A sample is done at the latest, over all earlier ones, of its arrival and the service since then.
    served = np.cumsum(service)
    times = served + np.maximum.accumulate(np.arange(n) * tau - served + service)
    tick = _tick(rng)
    share = float(rng.choice([0, 0, 0, 0.01, 0.05]))
    keep = _kept(rng, n, share)
    name = f"{kind}, {rate:.5g} Hz, load {load:.2f}, lost {share:g}, tick {tick} ns, n {n}"
    return name, Awkward(stamps=_stamped(times, tick)[keep], rate_hz=rate, samples=np.flatnonzero(keep))


def coarse(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return a clock with ticks of 1/32768 s to 10 ms; some samples are lost, some stamps jitter."""
    tick = float(rng.choice([SECOND / 32768, SECOND / 1024, 2.5e6, 1e6, 1e7, 1e5, 39062.5]))
    rate = float(rng.choice([50, 100, 104, 119, 200, 208, 400, 416, 833, 952, 1000]))
    rate *= 1 + rng.normal(0, 5e-3)
    n = int(rng.choice([3000, 20_000]))
    tau = SECOND / rate
    share = float(rng.choice([0, 0, 0.001, 0.01, 0.1, 0.3]))
    keep = _kept(rng, n, share)
    jitter = float(rng.choice([0, 0, 0.02, 0.1]))
    times = np.arange(n) * tau + rng.normal(0, jitter * tau, n)
    stamps = START + np.round(np.floor(times / tick) * tick).astype(np.int64)
    name = f"{tick / MS:.4g} ms, {rate:.5g} Hz, jitter {jitter:g}, lost {share:g}, n {n}"
    return name, Awkward(stamps=stamps[keep], rate_hz=rate, samples=np.flatnonzero(keep))


def half(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return a clock whose tick is exactly half a period, with losses and jitter."""
    rate = float(rng.choice([50, 100, 200, 250, 400, 500, 1000]))
    tick = SECOND / rate / 2
    n = int(rng.choice([3000, 20_000]))
    jitter = float(rng.choice([0, 0.01, 0.02, 0.05, 0.1]))
    share = float(rng.choice([0.001, 0.01, 0.05, 0.1, 0.2, 0.3]))
    keep = _kept(rng, n, share)
    offset = float(rng.choice([0, 0.25, 0.5]))
    places = np.arange(n) + offset + rng.normal(0, jitter, n)
    stamps = START + np.round(np.floor(2 * places) * tick).astype(np.int64)
    name = f"{rate:g} Hz in {tick / MS:g} ms, jitter {jitter:g}, lost {share:g}, offset {offset:g}, n {n}"
    return name, Awkward(stamps=stamps[keep], rate_hz=rate, samples=np.flatnonzero(keep))


def phone(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return the log of a phone: Android's rates, slow drift, jitter of 1 to 30 %, pauses, losses."""
    rate = float(rng.choice([50, 100, 119.6, 201.3, 399, 416, 104])) * (1 + rng.normal(0, 1e-2))
    n = int(rng.choice([3000, 20_000, 60_000]))
    sample = np.arange(n)
    tau = SECOND / rate
    drift = np.cumsum(2e-5 * np.sin(sample / rng.uniform(500, 5000))) * tau
    jitter = float(rng.choice([0.01, 0.05, 0.1, 0.2, 0.3]))
    times = sample * tau + drift + rng.normal(0, jitter * tau, n)
    share = float(rng.choice([0, 0, 0, 0.002, 0.02, 0.1, 0.3]))
    keep = rng.random(n) >= share
    for _ in range(int(rng.integers(0, 4))):
        first = int(rng.integers(n))
        keep[first : first + int(rng.integers(1, n // 10))] = False
    keep[[0, -1]] = True
    tick = _tick(rng)
    name = f"{rate:.5g} Hz, jitter {jitter:g}, lost {share:g}, tick {tick} ns, n {n}"
    return name, Awkward(stamps=_stamped(times, tick)[keep], rate_hz=rate, samples=sample[keep])


def wifi(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return packets of 1 to 20 samples with log-normal delays, delivered in order, some after beacons."""
    rate = float(rng.choice([50, 100, 200, 400])) * (1 + rng.normal(0, 2e-3))
    n = int(rng.choice([4000, 20_000, 60_000]))
    tau = SECOND / rate
    size = int(rng.choice([1, 1, 2, 5, 10, 20]))
    sample = np.arange(n)
    packet = sample // size
    count = n // size + 1
    sent = (packet * size + size - 1) * tau
    delay = rng.lognormal(np.log(2 * MS), rng.uniform(0.3, 1.2), count)
    times = np.maximum.accumulate(sent + delay[packet])
    beacon = bool(rng.random() < 0.4)
    if beacon:
        interval = 102.4 * MS
        times = np.ceil(times / interval) * interval + rng.exponential(1e5, count)[packet]
        times = np.maximum.accumulate(times)
    new = np.diff(times, prepend=-1.0) > 0
    first = np.maximum.accumulate(np.where(new, sample, 0))
    times = times + (sample - first) * 50 * US
    share = float(rng.choice([0, 0, 0.01, 0.05]))
    gone = (rng.random(count) < share)[packet]
    gone[[0, -1]] = False
    tick = _tick(rng)
    name = f"{size} of {rate:.5g} Hz, beacon {beacon}, lost {share:g}, tick {tick} ns, n {n}"
    return name, Awkward(stamps=_stamped(times, tick)[~gone], rate_hz=rate, samples=sample[~gone])


def _single(times: FloatArray, _: np.random.Generator) -> tuple[BoolArray, FloatArray]:
    return np.ones(times.size, dtype=np.bool_), (times + 72_000).astype(np.float32).astype(np.float64)


def _reset(times: FloatArray, _: np.random.Generator) -> tuple[BoolArray, FloatArray]:
    return np.ones(times.size, dtype=np.bool_), np.where(times > 300, times - 250, times) * 1.0002


def _jittering(times: FloatArray, rng: np.random.Generator) -> tuple[BoolArray, FloatArray]:
    return np.ones(times.size, dtype=np.bool_), times + rng.normal(0, 0.003, times.size)


#: Clocks of `tests/benchmarks/pathologies.py`: name, rate in Hz, rate by the stamps, change of the times.
_NUMBERED = (
    ("4 ms at 200 Hz", 200.0, 200.0, ticks(0.004)),
    ("8 ms at 100 Hz", 100.0, 100.0, ticks(0.008)),
    ("1 ms at 900 Hz, 2 % lost", 900.0, 900.0, ticks(0.001, 0.02)),
    ("float32 after 20 h", 200.0, 200.0, _single),
    *((f"lost {share:g}", 100.0, 100.0, lost(share)) for share in (0.05, 0.1, 0.2, 0.3)),
    ("lost in threes", 100.0, 100.0, lost(0.3, 3)),
    ("100 to 50 Hz", 100.0, 100.0, kept(lambda k: (k < 30_000) | (k % 2 == 0))),
    ("half of 10 s", 100.0, 100.0, kept(lambda k: k % 1000 < 500)),
    ("64 of 72", 100.0, 100.0, kept(lambda k: k % 72 < 64)),
    ("32 of 33", 100.0, 100.0, kept(lambda k: k % 33 < 32)),
    ("9 of 10", 100.0, 100.0, kept(lambda k: k % 10 < 9)),
    ("trials", 50.0, 50.0, kept(lambda k: k % 1500 < 100 + k // 1500 % 7)),
    ("jitter 0.3", 100.0, 100.0, _jittering),
    ("reset", 100.0, 100.0 / 1.0002, _reset),
)


def numbered(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return one of the clocks of `tests/benchmarks/pathologies.py`."""
    name, rate, true_rate, change = _NUMBERED[int(rng.integers(len(_NUMBERED)))]
    keep, times = change(np.arange(60_000) / rate, rng)
    stamps = np.round(times * SECOND).astype(np.int64)
    return name, Awkward(stamps=stamps, rate_hz=true_rate, samples=np.flatnonzero(keep))


#: Name -> number of clocks at scale 1, and the function that draws one.
SETS: dict[str, tuple[int, Draw]] = {
    "drawn": (2000, drawn),
    "pathologies": (1000, pathology),
    "numbered": (100, numbered),
    "common": (600, common),
    "usb": (300, usb),
    "queue": (200, queue),
    "ticks": (400, coarse),
    "phones": (300, phone),
    "wifi": (300, wifi),
    "half": (200, half),
}
#: The clocks of `tests/readers/clocks/awkward.py`.
_FIXED = "awkward"


def _clocks(name: str, seed: int, scale: float) -> Iterator[tuple[str, Awkward, bool]]:
    """Yield name, clock and whether its values are compared, too."""
    if name == _FIXED:
        for label, case in (*kinds(), *fifos()):
            yield label, case, True
        return
    count, draw = SETS[name]
    rng = np.random.default_rng([seed, list(SETS).index(name)])
    for _ in range(round(count * scale)):
        label, case = draw(rng)
        yield label, case, False


def _names(text: str, rate_hz: float) -> bool:
    """Return whether a text contains the rate."""
    rates = re.findall(r"([0-9.]+(?:e[+-]?[0-9]+)?) Hz", text)
    return any(abs(float(rate) / rate_hz - 1) <= _MAX_OFF for rate in rates)


def _counts_match(reading: ClockReading, case: Awkward, off: float) -> bool:
    """Return whether all samples are kept and the number of missing samples is right."""
    once = np.unique(case.samples).size
    lost_samples = int(case.samples.max() - case.samples.min()) + 1 - once
    # Each gap in the samples is counted to one sample, or to one batch.
    gaps = np.count_nonzero(np.diff(np.sort(case.samples)) > 1)
    miscounted = abs(reading.clock.missing - lost_samples)
    return _kept_all(reading, case) and bool(miscounted <= 2 + gaps + (2e-3 + off) * lost_samples)


def _kept_all(reading: ClockReading, case: Awkward) -> bool:
    return reading.clock.n >= 0.998 * np.unique(case.samples).size - 2


def verdict(case: Awkward, *, with_values: bool) -> tuple[str, str]:
    """Return the verdict and its details."""
    twice = None
    if with_values:
        drawn_values = np.random.default_rng(1).normal(0, 1, (6, int(case.samples.max()) + 1))
        twice = repeats(case.stamps, drawn_values[:, case.samples])
    try:
        reading = clock_from_stamps(case.stamps, source="stamps", repeated=twice)
    except ImucalError as error:
        sentence = error.sentence
        return ("asked" if _names(sentence, case.rate_hz) else "asked, unnamed"), sentence
    clock = reading.clock
    off = clock.rate_hz / case.rate_hz - 1
    notes = [finding for finding in reading.findings if finding.code in _RATE_FINDINGS]
    codes = " ".join(finding.code for finding in reading.findings)
    details = f"{clock.rate_hz:.6g} Hz ({off:+.2%}), {clock.n} samples, {clock.missing} missing, {codes}"
    if abs(off) <= _MAX_OFF and _kept_all(reading, case):
        if notes:
            return "warned, right", details
        if not _counts_match(reading, case, abs(off)):
            details = f"miscounted: {details}"
        return "right", details
    if not notes:
        return "silent", details
    texts = " ".join(finding.text for finding in notes)
    return ("warned, wrong" if _names(texts, case.rate_hz) else "warned, unnamed"), details


def with_true_rate(case: Awkward) -> str:
    """Return "read" if the true rate reads a clock, otherwise the reason."""
    try:
        reading = clock_from_stamps(case.stamps, source="stamps", rate_hz=case.rate_hz)
    except ImucalError as error:
        return f"refused: {error.sentence}"
    codes = {finding.code for finding in reading.findings}
    if "rate-given" in codes:
        return next(finding.text for finding in reading.findings if finding.code == "rate-given")
    if "rate-changes" not in codes and not _kept_all(reading, case):
        return f"{reading.clock.n} samples"
    return "read"


def main() -> None:
    """Print a line for each shown clock, and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--only", nargs="+", choices=[*SETS, _FIXED], default=[*SETS, _FIXED])
    parser.add_argument("--show", nargs="+", default=["silent"], help="starts of the verdicts to print")
    arguments = parser.parse_args()
    columns = (*VERDICTS, "miscounted", "--rate fails", "CPU s")
    table = [f"| set | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    total = Counter[str]()
    for name in arguments.only:
        found = Counter[str]()
        seconds = 0.0
        for label, case, with_values in _clocks(name, arguments.seed, arguments.scale):
            began = time.process_time()
            outcome, details = verdict(case, with_values=with_values)
            seconds += time.process_time() - began
            found[outcome] += 1
            found["miscounted"] += details.startswith("miscounted")
            if outcome.startswith(tuple(arguments.show)):
                print(f"[{name}] {label}: {outcome}: {details}", flush=True)
            if outcome not in {"right", "warned, right"} and (again := with_true_rate(case)) != "read":
                found["--rate fails"] += 1
                print(f"[{name}] {label}: with the true rate: {again}", flush=True)
        total.update(found)
        cells = [str(found[column]) for column in columns[:-1]]
        table.append(f"| {name} | {' | '.join(cells)} | {seconds:.1f} |")
        print(table[-1], flush=True)
    cells = [str(total[column]) for column in columns[:-1]]
    print("\n".join([*table, f"| sum | {' | '.join(cells)} | |"]))


if __name__ == "__main__":
    main()

"""Accuracy of clocks with known truth, and the clocks of real logs: rate, samples, gaps, findings.

    python -m tests.benchmarks.clocks 3000 --seed 7
    python -m tests.benchmarks.clocks 1000 --seed 7 --pathologies
    python -m tests.benchmarks.clocks --real FOLDER > now.txt    # the same at another commit, and diff

The sweep draws buffers of 2 to 128 samples with own ticks of 1 us to 1 ms, fixed and random, on clocks of ns,
us and ms, with and without a gap or a stop of an hour; and losses of 0.1 to 40 % with jitter. A clock is
right if its rate is within 0.1 % and all samples are kept; it is refused by an error with two readings.

`--pathologies` draws concatenated trials, duty cycles, FIFO overruns, clocks with a tick above half a
period, changing rates and two sensors under one name. Right also needs the number of missing samples; a
refusal or a warning only counts if it contains the true rate within 0.5 %.
"""

import argparse
import re
from collections import Counter
from pathlib import Path

import numpy as np

from imucal.errors import ChoiceError, ImucalError
from imucal.readers import read
from imucal.readers.clocks import clock_from_stamps
from tests.readers.clocks.awkward import (
    MS,
    SECOND,
    SIZES,
    US,
    Awkward,
    coarse,
    even,
    fifo,
    fused,
    lossy,
    switched,
    trials,
)

_LOGS = {".csv", ".txt", ".bag", ".mcap", ".db3", ".ulg", ".npz"}


def drawn(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return the name and a clock of random kind."""
    rate, n = float(rng.choice([50, 100, 104, 200, 208, 400, 416])), int(rng.choice([2500, 4000, 10_000]))
    if rng.random() < 0.3:
        share, jitter = float(rng.choice([0.001, 0.01, 0.05, 0.2, 0.4])), float(rng.choice([0, 0.02, 0.05]))
        name = f"lost {share:g}, jitter {jitter:g}"
        return name, lossy(rate, share, jitter=jitter, n=n, seed=int(rng.integers(1 << 30)))
    size, own = int(rng.choice(SIZES)), float(rng.choice([1, 10, 100, 300, 1000]))
    tick, seed = int(rng.choice([1, US, MS])), int(rng.integers(2)) * int(rng.integers(1, 1 << 30))
    # A buffer is read before it is full again.
    anchor = str(rng.choice(["first", "last", *(["read"] if own * US < 0.3 * SECOND / rate else [])]))
    case = fifo(rate, size, own, tick, n=n, seed=seed, anchor=anchor)
    kind, place = str(rng.choice(["whole", "gap", "stop"])), np.arange(n)
    keep = (place < n // 3) | (place >= n // 3 + 1000) if kind == "gap" else np.ones(n, dtype=np.bool_)
    stamps = case.stamps + np.where((place >= n // 2) & (kind == "stop"), 3600 * SECOND, 0)
    name = f"{size} of {rate:g} Hz, {own:g} us, tick {tick} ns, {anchor}, {kind}, seed {seed}"
    return name, Awkward(stamps=stamps[keep], rate_hz=rate, samples=case.samples[keep])


def _trials(rng: np.random.Generator) -> tuple[str, Awkward]:
    count, size = int(rng.choice([5, 10, 30, 100, 300])), int(rng.choice([25, 50, 100, 200, 500, 1000]))
    rate, jitter = float(rng.choice([20, 50, 64, 100, 104, 200, 500, 1000])), float(rng.choice([0, 1.5]))
    jitter = min(jitter, 200 / rate)
    sizes = np.full(count, size) if rng.random() < 0.5 else rng.integers(size // 2, 3 * size // 2, count)
    least, most = np.sort(rng.uniform(1, 60, 2))
    tick = int(rng.choice([1, US, MS]))
    case = trials(rate, sizes, rng.uniform(least, most, count), jitter_ms=jitter, tick=tick)
    name = f"{count} trials of {size} at {rate:g} Hz, jitter {jitter:g} ms, tick {tick} ns"
    return f"{name}, pauses {least:.3g} to {most:.3g} s", case


def _duty(rng: np.random.Generator) -> tuple[str, Awkward]:
    rate, n = float(rng.choice([20, 50, 100, 104, 200, 208, 500, 1000])), 40_000
    if rng.random() < 0.4:
        keep = round(float(rng.choice([0.5, 1, 5, 10])) * rate)
        of = keep + round(float(rng.choice([0.5, 1, 5, 10, 30])) * rate)
    else:
        keep, of = ((64, 72), (32, 33), (9, 10), (7, 8), (2, 3), (12, 16), (100, 110), (28, 40))[
            rng.integers(8)
        ]
    jitter = float(rng.choice([0, 0.001, 0.05]))
    tick = int(rng.choice([1, US, MS]))
    sample = np.flatnonzero(np.arange(max(n, 12 * of)) % of < keep)
    case = even(rate, tick, n=max(n, 12 * of), jitter=jitter)
    case = Awkward(stamps=case.stamps[sample], rate_hz=rate, samples=sample)
    return f"{keep} of {of} at {rate:g} Hz, jitter {jitter:g}, tick {tick} ns", case


def _coarse(rng: np.random.Generator) -> tuple[str, Awkward]:
    rates = {4e6: (150, 240), 8e6: (80, 122), 2e6: (300, 460), 1e6: (600, 952), 1e9 / 256: (140, 245),
             1e9 / 128: (75, 122), 1e9 / 64: (36, 60)}  # fmt: skip
    tick = float(rng.choice(list(rates)))
    rate, lost = float(rng.uniform(*rates[tick])), float(rng.choice([0, 0.01, 0.03, 0.05]))
    if rng.random() < 0.4:
        rate, lost = {4e6: 200.0, 8e6: 100.0, 2e6: 400.0, 1e6: 800.0}.get(tick, round(rate)), 0.0
    n = int(rng.choice([3000, 6000, 60_000]))
    case = coarse(rate, tick, n=n, lost=lost, seed=int(rng.integers(1 << 30)))
    return f"{rate:.6g} Hz, tick {tick / MS:g} ms, lost {lost:g}, n {n}", case


def _changing(rng: np.random.Generator) -> tuple[str, Awkward]:
    share, n = float(rng.uniform(0.1, 0.9)), int(rng.choice([3000, 20_000, 100_000]))
    if rng.random() < 0.5:
        first, then = ((100, 50), (50, 100), (200, 100), (100, 25), (104, 208))[rng.integers(5)]
        return f"{first} to {then} Hz after {share:.2f}, n {n}", switched(first, then, n=n, share=share)
    rate, offset = float(rng.choice([9.5, 50, 100])), float(rng.uniform(0.1, 0.9))
    return f"two sensors of {rate:g} Hz, {share:.2f}, {offset:.2f}, n {n}", fused(
        rate, n=n, share=share, offset=offset
    )


def pathology(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return the name and a clock of random kind with a plausible wrong reading."""
    return (_trials, _duty, _coarse, _changing)[rng.integers(4)](rng)


def _names(text: str, rate_hz: float) -> bool:
    """Return whether a message contains a rate within 0.5 % of the true one."""
    rates = re.findall(r"([0-9.]+(?:e[+-]?[0-9]+)?) Hz", text)
    return any(abs(float(rate) / rate_hz - 1) <= 0.005 for rate in rates)


def verdict_of_pathology(case: Awkward) -> str:
    """Return the verdict on a pathological clock; a wrong rate with a finding about its cause is known."""
    try:
        reading = clock_from_stamps(case.stamps, source="stamps")
    except ChoiceError as error:
        return "refused" if _names(str(error), case.rate_hz) else f"wrong: refused without the rate: {error}"
    clock = reading.clock
    lost = int(case.samples[-1] - case.samples[0]) + 1 - case.stamps.size
    off = abs(clock.rate_hz / case.rate_hz - 1)
    gaps = np.count_nonzero(np.diff(case.samples) > 1)
    # Coarse or jittering stamps hide at most one sample of a gap.
    kept = (
        clock.n >= 0.998 * case.stamps.size - 2
        and abs(clock.missing - lost) <= 2 + gaps + (1e-3 + off) * lost
    )
    messages = " ".join(f.text for f in reading.findings if f.code in {"two-readings", "rate-changes"})
    if _names(messages, case.rate_hz):
        return f"warned: {off:.2%} off"
    if messages:
        return f"wrong: warned without the rate: {messages}"
    # The least-squares slope of short trials with jitter is not more precise.
    sizes = np.diff(np.flatnonzero(np.diff(case.samples, prepend=-9, append=1 << 60) > 1))
    best = 4 * np.sqrt(12) * clock.jitter_s * clock.rate_hz / np.sqrt(float((sizes**3.0).sum()))
    if off < max(1e-3, best) and kept:
        return "right"
    return f"wrong: {clock.rate_hz:.6g} Hz, {clock.n} samples, {clock.missing} missing, not {lost}"


def verdict(case: Awkward) -> str:
    """Return whether a clock is right, refused or wrong, with the reason."""
    try:
        clock = clock_from_stamps(case.stamps, source="stamps").clock
    except ImucalError:
        return "refused"
    right = abs(clock.rate_hz / case.rate_hz - 1) < 1e-3 and clock.n >= case.stamps.size - 2
    return "right" if right else f"wrong: {clock.rate_hz:.6g} Hz, {clock.n} samples, {clock.missing} missing"


def of_real(path: Path) -> str:
    """Return the clocks and findings of a log, or the reason of an error."""
    try:
        recording = read(path, gyro_unit="deg/s", accel_unit="g")
    except ImucalError as error:
        return f"{type(error).__name__}: {str(error).removeprefix(str(path))[:160]}"
    clocks = {id(series.clock): series.clock for series in recording.series}.values()
    codes = sorted({finding.code for finding in recording.findings})
    shown = [f"{c.rate_hz:.7g} Hz, {c.n} samples, {c.missing} missing, {len(c.gaps)} gaps" for c in clocks]
    return "; ".join([*shown, " ".join(codes)])


def main() -> None:
    """Print a line for each clock that is not right, or for each real log."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("count", type=int, nargs="?", default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--real", type=Path)
    parser.add_argument("--pathologies", action="store_true")
    arguments = parser.parse_args()
    if arguments.real:
        for path in sorted(p for p in arguments.real.rglob("*") if p.suffix in _LOGS):
            print(f"{path.relative_to(arguments.real)}: {of_real(path)}")
        return
    rng = np.random.default_rng(arguments.seed)
    found = Counter[str]()
    for _ in range(arguments.count):
        name, case = pathology(rng) if arguments.pathologies else drawn(rng)
        outcome = verdict_of_pathology(case) if arguments.pathologies else verdict(case)
        found[outcome.partition(":")[0]] += 1
        if outcome != "right":
            print(f"{name}: {outcome}")
    print(", ".join(f"{count} {outcome}" for outcome, count in sorted(found.items())))


if __name__ == "__main__":
    main()

"""How many clocks of known truth are read right, and the clocks of real logs: rate, samples, gaps, findings.

    python -m tests.benchmarks.clocks 3000 --seed 7
    python -m tests.benchmarks.clocks --real FOLDER > now.txt    # the same at another commit, and diff

The sweep draws buffers of 2 to 128 samples with own ticks of 1 us to 1 ms, fixed and random, on clocks of ns,
us and ms, with and without a gap or a stop of an hour; and losses of 0.1 to 40 % with jitter. Right is a rate
within 0.1 % with all samples kept; refused is an error that names two readings.
"""

import argparse
from collections import Counter
from pathlib import Path

import numpy as np

from imucal.errors import ImucalError
from imucal.readers import read
from imucal.readers.clocks import clock_from_stamps
from tests.readers.clocks.awkward import MS, SECOND, SIZES, US, Awkward, fifo, lossy

_LOGS = {".csv", ".txt", ".bag", ".mcap", ".db3", ".ulg", ".npz"}


def drawn(rng: np.random.Generator) -> tuple[str, Awkward]:
    """Return a clock of random kind, by name."""
    rate, n = float(rng.choice([50, 100, 104, 200, 208, 400, 416])), int(rng.choice([2500, 4000, 10_000]))
    if rng.random() < 0.3:
        share, jitter = float(rng.choice([0.001, 0.01, 0.05, 0.2, 0.4])), float(rng.choice([0, 0.02, 0.05]))
        name = f"lost {share:g}, jitter {jitter:g}"
        return name, lossy(rate, share, jitter=jitter, n=n, seed=int(rng.integers(1 << 30)))
    size, own = int(rng.choice(SIZES)), float(rng.choice([1, 10, 100, 300, 1000]))
    tick, seed = int(rng.choice([1, US, MS])), int(rng.integers(2)) * int(rng.integers(1, 1 << 30))
    # Whoever reads a buffer is done before it is full again.
    anchor = str(rng.choice(["first", "last", *(["read"] if own * US < 0.3 * SECOND / rate else [])]))
    case = fifo(rate, size, own, tick, n=n, seed=seed, anchor=anchor)
    kind, place = str(rng.choice(["whole", "gap", "stop"])), np.arange(n)
    keep = (place < n // 3) | (place >= n // 3 + 1000) if kind == "gap" else np.ones(n, dtype=np.bool_)
    stamps = case.stamps + np.where((place >= n // 2) & (kind == "stop"), 3600 * SECOND, 0)
    name = f"{size} of {rate:g} Hz, {own:g} us, tick {tick} ns, {anchor}, {kind}, seed {seed}"
    return name, Awkward(stamps=stamps[keep], rate_hz=rate, samples=case.samples[keep])


def verdict(case: Awkward) -> str:
    """Return whether a clock is read right, is refused, or is wrong, and how."""
    try:
        clock = clock_from_stamps(case.stamps, source="stamps").clock
    except ImucalError:
        return "refused"
    right = abs(clock.rate_hz / case.rate_hz - 1) < 1e-3 and clock.n >= case.stamps.size - 2
    return "right" if right else f"wrong: {clock.rate_hz:.6g} Hz, {clock.n} samples, {clock.missing} missing"


def of_real(path: Path) -> str:
    """Return the clocks of a log and what was found, or why it is not read as it is."""
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
    arguments = parser.parse_args()
    if arguments.real:
        for path in sorted(p for p in arguments.real.rglob("*") if p.suffix in _LOGS):
            print(f"{path.relative_to(arguments.real)}: {of_real(path)}")
        return
    rng = np.random.default_rng(arguments.seed)
    found = Counter[str]()
    for _ in range(arguments.count):
        name, case = drawn(rng)
        said = verdict(case)
        found[said.partition(":")[0]] += 1
        if said != "right":
            print(f"{name}: {said}")
    print(", ".join(f"{count} {said}" for said, count in sorted(found.items())))


if __name__ == "__main__":
    main()

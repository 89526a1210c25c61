"""`imucal.fit` of one axis: CPU time relative to y, memory, and neighbouring lengths.

    python tests/benchmarks/bench_axis.py [--large] [--near 2160000]

`--large` adds 1e8 samples. Some rows are of records with gaps of half a second, which should take at most
1.6 times as long as without gaps. Each length runs in its own process; y is that of `bench_job`. Neighbours
are n - 20 … n + 20 and the primes on both sides; each should take at most 1.2 times the median.
"""

import argparse
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

import imucal
from imucal.recording import AxisSeries
from tests.benchmarks.bench_job import yardstick

#: Samples and gaps of the records, and missing samples per gap.
_RECORDS = ((10**6, 0), (10**7, 0), (10**7, 1), (10**7, 5), (10**7, 60))
_GAP = 100
#: Sampling interval of the memory, in s.
_LOOK = 0.002
#: Measured lengths relative to `--near`.
_OFFSETS = (-20, -19, -13, -7, -3, -2, -1, 0, 1, 2, 3, 7, 13, 19, 20)


def resident() -> int:
    """Return the memory of this process, in bytes."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return 4096 * pages


def axis(n: int) -> AxisSeries:
    """Return white noise."""
    return AxisSeries.from_samples(np.random.default_rng(5).standard_normal(n), rate_hz=200.0)


def measure(n: int, gaps: int) -> dict[str, float]:
    """Return CPU time in s and additional bytes per sample of a fit."""
    series = axis(n)
    if gaps:
        keep = np.ones(n, dtype=np.bool_)
        for gap in range(gaps):
            first = (gap + 1) * n // (gaps + 1)
            keep[first : first + _GAP] = False
        series = series.keeping(keep)
        del keep
    imucal.fit(axis(20_000))
    before, highest, stop = resident(), 0, threading.Event()

    def watch() -> None:
        nonlocal highest
        while not stop.wait(_LOOK):
            highest = max(highest, resident())

    watching = threading.Thread(target=watch)
    watching.start()
    start = time.thread_time()
    imucal.fit(series)
    cpu = time.thread_time() - start
    stop.set()
    watching.join()
    return {"cpu": cpu, "bytes": max(highest - before, 0) / n}


def alone(n: int, gaps: int) -> dict[str, float]:
    """Measure in a separate process."""
    command = [sys.executable, "-m", "tests.benchmarks.bench_axis", "--one", str(n), str(gaps)]
    done = subprocess.run(command, check=True, capture_output=True, cwd=Path(__file__).parents[2])  # noqa: S603
    found: dict[str, float] = json.loads(done.stdout)
    return found


def primes_about(n: int) -> tuple[int, int]:
    """Return the largest prime below `n` and the smallest above."""

    def is_prime(number: int) -> bool:
        return all(number % divisor for divisor in range(2, int(number**0.5) + 1))

    below = next(number for number in range(n - 1, 1, -1) if is_prime(number))
    above = next(number for number in range(n + 1, 2 * n + 3) if is_prime(number))
    return below, above


def neighbours(n: int) -> None:
    """Print the CPU time of lengths near `n`, the best of five, relative to their median."""
    lengths = sorted({*(n + offset for offset in _OFFSETS), *primes_about(n)})
    samples = axis(max(lengths)).samples
    imucal.fit(axis(20_000))
    seconds = dict.fromkeys(lengths, np.inf)
    for _ in range(5):
        for length in lengths:
            start = time.thread_time()
            imucal.fit(AxisSeries.from_samples(samples[:length], rate_hz=200.0))
            seconds[length] = min(seconds[length], time.thread_time() - start)
    middle = float(np.median(list(seconds.values())))
    slowest = max(seconds, key=lambda length: seconds[length])
    most = seconds[slowest]
    print(f"\n| lengths about {n} | median CPU s | slowest | CPU s | over the median |")
    print("|---|---|---|---|---|")
    print(f"| {len(lengths)} | {middle:.2f} | {slowest} | {most:.2f} | {most / middle:.2f} |")


def main() -> None:
    """Print the tables in Markdown."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--near", type=int, default=2_160_000)
    parser.add_argument("--one", type=int, nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measure(*given.one)))
        return
    ys = [yardstick() for _ in range(2)]
    found = {}
    for n, gaps in [*_RECORDS, *([(10**8, 0)] if given.large else [])]:
        found[n, gaps] = min((alone(n, gaps) for _ in range(2)), key=lambda run: run["cpu"])
    y = min(*ys, yardstick())
    print("| white samples | CPU s | CPU / y | ns a sample | bytes a sample beside them |")
    print("|---|---|---|---|---|")
    for (n, gaps), best in found.items():
        cpu, whole = best["cpu"], found[n, 0]["cpu"]
        numbers = f"{cpu:.2f} | {cpu / y:.2f} | {1e9 * cpu / n:.0f} | {best['bytes']:.1f}"
        name = f"{n:.0e}, {gaps} gaps: {cpu / whole:.1f} × without" if gaps else f"{n:.0e}"
        print(f"| {name} | {numbers} |", flush=True)
    neighbours(given.near)


if __name__ == "__main__":
    main()

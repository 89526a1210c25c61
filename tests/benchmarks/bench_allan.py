"""The Allan engine compared with AllanTools and plain NumPy: CPU time, memory, bandwidth, rounding.

    python tests/benchmarks/bench_allan.py [--large] [--targets]

Every contender runs in its own process, so that none profits from another's warm memory. Times are CPU
seconds (user and system) of the first call and of the best of three. ``--large`` adds n = 1e8: the
relative error against exact integers on a mean of 9.8 million sigma. ``--targets`` only runs the measurements
of the targets.
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from imucal.allan.intervals import degrees_of_freedom
from imucal.allan.variance import variances
from imucal.arrays import FloatArray, IntArray

__all__ = ["main"]

#: Samples -> required ratio of AllanTools' time to the curve with intervals, best of three.
TARGETS = {1_000_000: 2.5, 10_000_000: 5.0}


def factors(n: int) -> IntArray:
    """Return about 90 factors up to n/10, evenly spaced in log."""
    return np.unique(np.round(np.logspace(0, np.log10(n / 10), 100)).astype(np.int64))


def plain(samples: FloatArray, m: IntArray) -> FloatArray:
    """Return the overlapping variances as a simple script computes them, with full-length temporaries."""
    angle = np.concatenate([[0.0], np.cumsum(samples - samples.mean())])
    avar = np.empty(m.size)
    for i, k in enumerate(m.tolist()):
        steps = angle[2 * k :] - 2 * angle[k:-k] + angle[: -2 * k]
        avar[i] = np.mean(steps**2) / (2 * k * k)
    return avar


def allantools(samples: FloatArray, m: IntArray) -> FloatArray:
    import allantools as peer

    _, deviation, _, _ = peer.oadev(samples, rate=1.0, data_type="freq", taus=m.astype(np.float64))
    squares: FloatArray = deviation**2
    return squares


def exact(samples: FloatArray, m: IntArray) -> FloatArray:
    return variances(samples, m)


def intervals(samples: FloatArray, m: IntArray) -> FloatArray:
    return degrees_of_freedom(samples, m)


def with_intervals(samples: FloatArray, m: IntArray) -> FloatArray:
    """Return the variances after computing their degrees of freedom, like `allan_curve`."""
    intervals(samples, m)
    return exact(samples, m)


CONTENDERS: dict[str, Callable[[FloatArray, IntArray], FloatArray]] = {
    "AllanTools oadev": allantools,
    "plain NumPy": plain,
    "imucal exact": exact,
    "imucal intervals": intervals,
    "imucal curve with intervals": with_intervals,
}


def peak_mb() -> float:
    """Return the peak memory of this process in MB; /proc excludes the parent's memory."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(text for text in status.read_text(encoding="ascii").splitlines() if "VmHWM" in text)
        return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def one(name: str, n: int) -> None:
    """Run one contender in this process; print its figures as JSON."""
    samples = np.random.default_rng(0).standard_normal(n)
    m = factors(n)
    CONTENDERS[name](samples[:5000], factors(5000))
    before = peak_mb()
    spent = []
    values = np.zeros(0)
    for _ in range(4):
        began = time.process_time()
        values = CONTENDERS[name](samples, m)
        spent.append(time.process_time() - began)
    figures = {"first": spent[0], "best": min(spent[1:]), "mb": peak_mb() - before}
    print(json.dumps(figures | {"values": values.tolist(), "factors": values.size}))


def copy_bandwidth() -> float:
    """Return the bytes read and written per second while copying 200 MB, best of five."""
    source = np.ones(25_000_000)
    target = np.empty_like(source)
    best = np.inf
    for _ in range(5):
        began = time.perf_counter()
        np.copyto(target, source)
        best = min(best, time.perf_counter() - began)
    return 2 * source.nbytes / best


def compare(n: int, bandwidth: float) -> str:
    """Print the table of one length; return the row of its target."""
    m = factors(n)
    terms = int(np.sum(n - 2 * m + 1))
    print(f"\nn = {n:.0e}, {m.size} factors up to n/10; copy bandwidth {bandwidth / 1e9:.1f} GB/s\n")
    print(
        "| way | first, s | best, s | x AllanTools (first, best) | ns/(sample*factor) | of copy | MB beside |"
    )
    print("|---|---|---|---|---|---|---|")
    results = {}
    named = ("AllanTools oadev", "imucal curve with intervals")
    for name in named if "--targets" in sys.argv else CONTENDERS:
        # A separate process, so that no contender uses the memory of another.
        run = subprocess.run(  # noqa: S603 - this very script
            [sys.executable, __file__, "--one", name, str(n)],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        results[name] = json.loads(run.stdout)
    peer = results["AllanTools oadev"]
    for name, got in results.items():
        ns = got["best"] / terms * 1e9
        share = 8 / (ns * 1e-9) / bandwidth
        print(
            f"| {name} | {got['first']:.3f} | {got['best']:.3f} | {peer['first'] / got['first']:.1f}, "
            f"{peer['best'] / got['best']:.1f} | {ns:.2f} | {share:.1f} | {got['mb']:.0f} |"
        )
    own = results["imucal curve with intervals"]
    error = np.max(np.abs(np.array(own["values"]) / np.array(peer["values"]) - 1))
    print(f"\nlargest relative difference to AllanTools: {error:.1e}")
    ratio = peer["best"] / own["best"]
    met = "yes" if ratio >= TARGETS[n] else "no"
    return f"| AllanTools / curve with intervals, n = {n:.0e} | ≥ {TARGETS[n]:g} | {ratio:.1f} | {met} |"


def large() -> None:
    """Measure the rounding error at n = 1e8 against integers."""
    n = 100_000_000
    rng = np.random.default_rng(2)
    whole = np.rint(rng.standard_normal(n) * 1e5).astype(np.int64) + 980_000_000_000
    m = np.array([1, 10, 1000, 8192, 100_000, 10_000_000])
    got = exact(whole.astype(np.float64), m)
    angle = np.concatenate([[0], np.cumsum(whole - 980_000_000_000)])
    worst = 0.0
    for k, value in zip(m.tolist(), got.tolist(), strict=True):
        total = 0.0
        for start in range(0, n + 1 - 2 * k, 10_000_000):
            stop = min(start + 10_000_000, n + 1 - 2 * k)
            steps = angle[start + 2 * k : stop + 2 * k] - 2 * angle[start + k : stop + k] + angle[start:stop]
            total += float(np.sum(np.square(steps.astype(np.float64))))
        true = total / (2.0 * k * k * (n + 1 - 2 * k))
        worst = max(worst, abs(value / true - 1))
    print(f"\nn = 1e8, mean 9.8e11, sigma 1e5: relative error at most {worst:.1e} against integers")
    del whole, angle


def main() -> None:
    if sys.argv[1:2] == ["--one"]:
        one(sys.argv[2], int(sys.argv[3]))
        return
    if "--large" in sys.argv:
        large()
    bandwidth = copy_bandwidth()
    rows = [compare(n, bandwidth) for n in TARGETS]
    print("\n| what | wanted | measured | met |\n|---|---|---|---|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()

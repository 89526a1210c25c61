"""CPU time of one axis: Allan curve with intervals, and the complete fit; best of three.

    python tests/benchmarks/bench_fit.py [samples …]

CPU time includes every thread, so a busy machine hardly changes it. Targets: 1 s for an axis of 1e6
samples, 5 s for 1e7 samples.
"""

import sys
import time
from collections.abc import Callable

import numpy as np

from imucal.allan import allan_curve
from imucal.fitting import fit
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries

MODELS = {
    "N + B + K": "N=1 + B=0.06324555320336758 + K=5.477225575051661e-4",
    "N + 2*GM + K": "N=1 + GM(sigma=0.2236, T=50) + GM(sigma=0.1, T=3000) + K=3.1623e-4",
}


def best(work: Callable[[], object], repeats: int) -> float:
    """Return the smallest CPU time of some runs, in s."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return min(seconds)


def main() -> None:
    """Print a table in Markdown."""
    sizes = [int(float(text)) for text in sys.argv[1:]] or [10**5, 10**6, 10**7]
    fit(AxisSeries.from_samples(np.random.default_rng(0).standard_normal(1000), rate_hz=1.0))
    print("| samples | truth | curve s | fit, model chosen s | fit, model given s | sum s | ns/sample |")
    print("|---|---|---|---|---|---|---|")
    for n in sizes:
        repeats = 3 if n <= 10**6 else 1
        for name, text in MODELS.items():
            samples = NoiseModel.parse(text).simulate(n, rate_hz=1.0, rng=np.random.default_rng(1))
            series = AxisSeries.from_samples(samples, rate_hz=1.0)
            curve = allan_curve(series)
            first = best(lambda series=series: allan_curve(series), repeats)  # type: ignore[misc]
            chosen = best(lambda series=series, curve=curve: fit(series, curve=curve), repeats)  # type: ignore[misc]
            given = best(
                lambda series=series, curve=curve, name=name: fit(series, model=name, curve=curve),  # type: ignore[misc]
                repeats,
            )
            print(
                f"| {n} | {name} | {first:.3f} | {chosen:.3f} | {given:.3f} | {first + chosen:.3f} "
                f"| {(first + chosen) / n * 1e9:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

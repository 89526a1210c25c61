"""Cost of a decomposition, and coverage of its standard errors: prints tables in Markdown.

python tests/benchmarks/bench_decompose.py [records]
"""

import resource
import sys
import time

import numpy as np

from imucal import AxisSeries, NoiseModel, decompose

__all__ = ["costs", "coverage"]

_RATE = 100.0
_MODELS = ("N=1e-3 + K=1e-5", "N=1e-3 + GM(sigma=1e-4, T=100) + K=1e-5", "N=1e-3 + B=1e-4 + K=1e-5")


def costs() -> None:
    """Print CPU time by model, samples and losses, and the peak memory at the end."""
    print("| model | n | missing | CPU s |\n|---|---|---|---|")
    for text in _MODELS:
        model = NoiseModel.parse(text)
        for n, missing in ((100_000, 0.0), (1_000_000, 0.0), (200_000, 0.1)):
            rng = np.random.default_rng(91)
            samples = model.simulate(n, rate_hz=_RATE, rng=rng)
            series = AxisSeries.from_samples(samples, rate_hz=_RATE).keeping(rng.random(n) >= missing)
            begin = time.process_time()
            decompose(series, model)
            print(f"| {model} | {n:.0e} | {100 * missing:.0f} % | {time.process_time() - begin:.2f} |")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    print(f"\nat most {peak} MB, the samples and the interpreter included")


def coverage(records: int, n: int = 20_000) -> None:
    """Print the coverage of 1.96 standard errors of the bias, with a tenth of the record missing."""
    print("| model | bias within, % | standard error of that |\n|---|---|---|")
    for text in _MODELS:
        model, shares = NoiseModel.parse(text), []
        rng = np.random.default_rng(92)
        for _ in range(records):
            noise, *rest = (term.simulate(n, 1 / _RATE, rng) for term in model.terms)
            bias = np.sum(rest, axis=0)
            keep = np.ones(n, dtype=bool)
            keep[n // 2 : n // 2 + n // 10] = False
            series = AxisSeries.from_samples(noise + bias, rate_hz=_RATE).keeping(keep)
            found = decompose(series, model).bias
            shares.append(np.mean(np.abs(found.value - bias) < 1.96 * found.error))
        print(f"| {model} | {100 * np.mean(shares):.1f} | {100 * np.std(shares) / np.sqrt(records):.1f} |")


if __name__ == "__main__":
    costs()
    coverage(int(sys.argv[1]) if len(sys.argv) > 1 else 200)

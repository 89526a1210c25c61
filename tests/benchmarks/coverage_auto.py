"""Coverage of N, B and K when the model is not known: `imucal.fit` as a user runs it.

    python tests/benchmarks/coverage_auto.py --records 100 --seed 1 [--truth "N + B + K" …] [--jobs 2]

Each row is one truth, a consumer gyroscope at 100 Hz for 33 min: how many of 100 intervals hold the
true coefficient (0 where the truth has no such term), how often the term is shown (its interval
excludes 0), how many of those that are shown hold it, and the median of the upper limit. The standard
error of a figure of 95 % is 2.2 points with 100 records.
"""

import argparse
import os
import time
import zlib
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

import imucal
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS

TRUTHS = {
    "N": "N=1e-4",
    "N + B": "N=1e-4 + B=3e-5",
    "N + K": "N=1e-4 + K=3e-6",
    "N + R": "N=1e-4 + R=4e-7",
    "N + B + K": "N=1e-4 + B=3e-5 + K=3e-6",
    "N + B + K, strong": "N=1e-4 + B=1e-4 + K=2e-5",
    "N + K + R": "N=1e-4 + K=5e-6 + R=4e-7",
    "N + GM, 5 s": "N=1e-4 + GM(sigma=4e-5, T=5)",
    "N + GM, 5 s + K": "N=1e-4 + GM(sigma=4e-5, T=5) + K=8e-6",
}
RATE_HZ = 100.0
N = 200_000


def limits(name: str, seed: int, model: str, record: int) -> tuple[list[tuple[float, float]], float]:
    """Return the limits of N, B and K of one record, and the CPU seconds of its fit."""
    key = zlib.crc32(name.encode())
    rng = np.random.default_rng([seed, key, record])
    samples = NoiseModel.parse(TRUTHS[name]).simulate(N, rate_hz=RATE_HZ, rng=rng)
    series = imucal.AxisSeries.from_samples(samples, rate_hz=RATE_HZ)
    start = time.process_time()
    fit = imucal.fit(series, model=model)
    return [(fit[s].low, fit[s].high) for s in ALWAYS], time.process_time() - start


def structure(truth: str) -> str:
    """Return the structure of a model, such as ``N + K``."""
    return " + ".join(term.symbol for term in NoiseModel.parse(truth).terms)


def row(name: str, found: list[tuple[list[tuple[float, float]], float]]) -> str:
    """Return a row of the table."""
    truth = {term.symbol: term.coefficient for term in NoiseModel.parse(TRUTHS[name]).terms}
    table = np.array([spans for spans, _ in found])
    cells = []
    for column, symbol in enumerate(ALWAYS):
        low, high = table[:, column, 0], table[:, column, 1]
        holds = (low <= truth.get(symbol, 0.0)) & (truth.get(symbol, 0.0) <= high)
        shown = low > 0
        of_shown = f"{100 * holds[shown].mean():.0f}" if shown.any() else "–"
        cells.append(
            f"{100 * holds.mean():.0f} · {100 * shown.mean():.0f} · {of_shown} · {np.median(high):.3g}"
        )
    seconds = np.mean([cpu for _, cpu in found])
    return f"| {name} | {' | '.join(cells)} | {seconds:.2f} |"


def main() -> None:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--model", default="auto", help="a given structure instead of the choice; `truth`: each row's own"
    )
    parser.add_argument("--truth", nargs="*", default=list(TRUTHS), choices=list(TRUTHS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    heads = [f"{symbol}: cover · shown · of those · median limit" for symbol in ALWAYS]
    print(f"| truth | {' | '.join(heads)} | CPU s |\n|{'---|' * (len(heads) + 2)}")
    with ProcessPoolExecutor(options.jobs) as pool:
        for name in options.truth:
            model = structure(TRUTHS[name]) if options.model == "truth" else options.model
            work = partial(limits, name, options.seed, model)
            print(row(name, list(pool.map(work, range(options.records)))), flush=True)


if __name__ == "__main__":
    main()

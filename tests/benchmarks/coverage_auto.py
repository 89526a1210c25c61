"""Coverage of N, B and K with an unknown model: `imucal.fit` with its defaults.

    python tests/benchmarks/coverage_auto.py --records 100 --seed 1 [--truth "N + B + K" …] [--jobs 2]

Each row is one truth, a consumer gyroscope at 100 Hz for 33 min. The columns are the number of intervals
that cover the true coefficient, the number of detections (the interval excludes 0), the number of detections
that cover it, and the median of the upper limit. Further columns are the number of segments' floors whose
interval covers the true floor, and of records in which K is detected or not both at 100 Hz and averaged to
1 Hz. The truth of an absent term is 0. The truth of K for a Gauss-Markov term of 100 s and more is the walk
that it begins with, if K is detected. The standard error of 95 % is 2.2 points with 100 records.
"""

import argparse
import math
import os
import time
import zlib
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np

import imucal
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, GaussMarkov

#: Name -> model; a record has `N` samples at `RATE_HZ`, or the values in `RECORDS`.
TRUTHS = {
    "N + K, n = 1e4": "N=1 + K=0.01",
    "N": "N=1e-4",
    "N + B": "N=1e-4 + B=3e-5",
    "N + K": "N=1e-4 + K=3e-6",
    "N + R": "N=1e-4 + R=4e-7",
    "N + B + K": "N=1e-4 + B=3e-5 + K=3e-6",
    "N + B + K, K=8e-6": "N=1e-4 + B=3e-5 + K=8e-6",
    "N + B + K, strong": "N=1e-4 + B=1e-4 + K=2e-5",
    "N + K + R": "N=1e-4 + K=5e-6 + R=4e-7",
    "N + GM, 5 s": "N=1e-4 + GM(sigma=4e-5, T=5)",
    "N + GM, 5 s + K": "N=1e-4 + GM(sigma=4e-5, T=5) + K=8e-6",
    "N + GM, 100 s": "N=1e-4 + GM(sigma=4e-5, T=100)",
    "N + GM, 1000 s": "N=1e-4 + GM(sigma=1e-4, T=1000)",
    "N + GM, 5 s + GM, 150 s": "N=1e-4 + GM(sigma=4e-5, T=5) + GM(sigma=8e-5, T=150)",
}
RATE_HZ = 100.0
N = 200_000
RECORDS = {"N + K, n = 1e4": (10_000, 1.0)}
#: A Gauss-Markov term of this time or longer, in s, is a random walk in the record.
SLOW_S = 100.0


class Found(NamedTuple):
    """Results of one record.

    `limits` of N, B and K; `floors` that cover the true one, shape (s,); whether K is detected or not at both
    rates, None if not computed; and the CPU seconds of the fit.
    """

    limits: list[tuple[float, float]]
    floors: list[bool]
    same: bool | None
    cpu: float


def found_of(name: str, seed: int, model: str, record: int) -> Found:
    """Return the results of one record."""
    key = zlib.crc32(name.encode())
    rng = np.random.default_rng([seed, key, record])
    truth = NoiseModel.parse(TRUTHS[name])
    n, rate_hz = RECORDS.get(name, (N, RATE_HZ))
    samples = truth.simulate(n, rate_hz=rate_hz, rng=rng)
    start = time.process_time()
    fit = imucal.fit(imucal.AxisSeries.from_samples(samples, rate_hz=rate_hz), model=model)
    cpu = time.process_time() - start
    floors, same = [], None
    if fit.segments and (floor := fit.segments.floor):
        true = np.sqrt(truth.avar(np.array([fit.segments.floor_tau_s * rate_hz]), rate_hz=rate_hz))
        floors = ((floor.low <= true) & (true <= floor.high)).tolist()
    if rate_hz == RATE_HZ:
        means = samples.reshape(-1, round(RATE_HZ)).mean(axis=1)
        slow = imucal.fit(imucal.AxisSeries.from_samples(means, rate_hz=1.0), model=model, segments=1)
        same = (slow["K"].low > 0) == (fit["K"].low > 0)
    return Found([(fit[s].low, fit[s].high) for s in ALWAYS], floors, same, cpu)


def structure(truth: str) -> str:
    """Return the structure of a model, such as ``N + K``."""
    return " + ".join(term.symbol for term in NoiseModel.parse(truth).terms)


def row(name: str, found: list[Found]) -> str:
    """Return a row of the table."""
    terms = NoiseModel.parse(TRUTHS[name]).terms
    truth = {term.symbol: term.coefficient for term in terms}
    walks: dict[str, float] = {}
    for term in terms:
        if isinstance(term, GaussMarkov) and term.T >= SLOW_S:
            walks["K"] = term.sigma * math.sqrt(2 / term.T)
    table = np.array([each.limits for each in found])
    cells = []
    for column, symbol in enumerate(ALWAYS):
        low, high = table[:, column, 0], table[:, column, 1]
        shown = low > 0
        true = np.where(shown, walks.get(symbol, truth.get(symbol, 0.0)), truth.get(symbol, 0.0))
        holds = (low <= true) & (true <= high)
        of_shown = f"{100 * holds[shown].mean():.0f}" if shown.any() else "–"
        cells.append(
            f"{100 * holds.mean():.0f} · {100 * shown.mean():.0f} · {of_shown} · {np.median(high):.3g}"
        )
    floors = [holds for each in found for holds in each.floors]
    cells.append(f"{100 * np.mean(floors):.0f}" if floors else "–")
    same = [each.same for each in found if each.same is not None]
    cells.append(f"{100 * np.mean(same):.0f}" if same else "–")
    seconds = np.mean([each.cpu for each in found])
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
    heads += ["floors", "K alike at 1 Hz"]
    print(f"| truth | {' | '.join(heads)} | CPU s |\n|{'---|' * (len(heads) + 2)}")
    with ProcessPoolExecutor(options.jobs) as pool:
        for name in options.truth:
            model = structure(TRUTHS[name]) if options.model == "truth" else options.model
            work = partial(found_of, name, options.seed, model)
            print(row(name, list(pool.map(work, range(options.records)))), flush=True)


if __name__ == "__main__":
    main()

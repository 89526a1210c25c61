"""Statistics of pooled records of one unit: coverage of limits, false alarms, and weak squares.

``python -m tests.benchmarks.pooled_records [pools] [records] [samples] [seed]`` prints, for a strong and a
weak random walk, the coverage of pooled limits and the rate at which equal records differ; and the mean and
scatter of the squared coefficient of single logs, compared with its standard error.
"""

import sys
import time

import numpy as np

import imucal
from tests.fleet.records import bins_from, quick_fit, simulated

TRUTHS = ({"N": 1e-3, "B": 2e-4, "K": 2e-5}, {"N": 1e-3, "B": 2e-4, "K": 2e-4})


def main(pools: int = 100, records: int = 3, samples: int = 100_000, seed: int = 4711) -> None:
    """Print both tables."""
    bins = bins_from(simulated("N=1", samples, 0))
    arrays = ("n", "start", "first", "size", "power", "cross", "gram")
    print(f"bins of {samples} samples: {sum(getattr(bins, name).nbytes for name in arrays)} bytes")
    for number, truth in enumerate(TRUTHS):
        text = " + ".join(f"{key}={value}" for key, value in truth.items())
        held, alarms, seconds = [], [], 0.0
        squares: dict[str, list[tuple[float, float]]] = {key: [] for key in truth}
        for i in range(pools):
            fits = [quick_fit(simulated(text, samples, seed, number, i, j)) for j in range(records)]
            start = time.process_time()
            pooled = imucal.pool(fits)
            seconds += time.process_time() - start
            held.append([pooled[key].low <= value <= pooled[key].high for key, value in truth.items()])
            alarms.append([test.differs for test in pooled.homogeneity])
            for key, log in imucal.log_values("unit", fits[0]).items():
                if log.variance is not None and log.variance_sd is not None:
                    squares[key].append((log.variance, log.variance_sd))
        print(f"\n{text}: {pools} pools of {records}, {1e3 * seconds / pools:.0f} ms a pool")
        print("term  held   differs")
        for key, hold, alarm in zip(truth, np.mean(held, axis=0), np.mean(alarms, axis=0), strict=True):
            print(f"{key:4}  {hold:5.1%}  {alarm:5.1%}")
        for key, pairs in squares.items():
            if len(pairs) == pools:
                value, deviation = np.array(pairs).T
                scatter = np.std(value, ddof=1)
                away = (np.mean(value) - truth[key] ** 2) / (scatter / np.sqrt(pools))
                ratio = np.mean(deviation) / scatter
                print(f"{key}²: mean {away:+.2f} standard errors off, deviation / scatter {ratio:.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

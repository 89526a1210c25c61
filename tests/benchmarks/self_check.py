"""False alarm rate of the self-check for stationary records, and its alarms for real logs.

    python tests/benchmarks/self_check.py [RECORDS OF EACH] [SEED]

Truths are eight models at 10 Hz, with halves of 1000, 2000 and 5000 s. If ``IMUCAL_REAL_DATA`` names a
folder of real logs, complete runs and quarters of an ADIS16405 follow.
"""

import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import imucal
from imucal.prediction import self_check
from imucal.recording import AXES, AxisSeries

TRUTHS = (
    *("N=1e-3", "N=1e-3 + K=3e-5", "N=1e-3 + B=3e-4", "N=1e-3 + B=3e-4 + K=3e-5"),
    *("N=1e-3 + B=1e-3 + K=2e-4", "N=1e-3 + GM(sigma=5e-4, T=100)", "N=1e-3 + GM(sigma=1e-3, T=1000)"),
    "Q=3e-4 + N=1e-3 + B=3e-4",
)
HALVES_S = (1000, 2000, 5000)
RATE = 10.0


def simulated(records: int, seed: int) -> Iterator[tuple[str, AxisSeries]]:
    """Yield records of each truth and length, with the truth's text."""
    for number in range(records):
        for row, text in enumerate(TRUTHS):
            for half in HALVES_S:
                rng = np.random.default_rng([seed, row, half, number])
                samples = imucal.NoiseModel.parse(text).simulate(int(2 * half * RATE), rate_hz=RATE, rng=rng)
                yield text, AxisSeries.from_samples(samples, rate_hz=RATE)


def measured(folder: Path) -> Iterator[tuple[str, AxisSeries]]:
    """Yield complete runs and quarters of each axis of the ADIS16405, with the sensor's name."""
    for file in sorted((folder / "real" / "adis16405").glob("*.npz")):
        counts = np.load(file)
        for sensor, name, unit in (
            ("gyroscope", "gyro_counts", np.radians(0.05)),
            ("accelerometer", "accel_counts", 3.33e-3 * 9.80665),
        ):
            for axis, samples in zip(AXES, counts[name].T * unit, strict=True):
                for part in (samples, *np.array_split(samples, 4)):
                    yield sensor, AxisSeries.from_samples(part, rate_hz=100.0, sensor=sensor, axis=axis)


def show(title: str, records: Iterator[tuple[str, AxisSeries]]) -> None:
    """Print the alarm rate by kind, with and without a misfit, and the cost."""
    every, alarms, silent = Counter[str](), Counter[str](), Counter[str]()
    fitting = checking = 0.0
    for kind, series in records:
        start = time.process_time()
        fit = imucal.fit(series)
        between = time.process_time()
        found = bool(self_check(series, fit))
        fitting, checking = fitting + between - start, checking + time.process_time() - between
        every[kind] += 1
        alarms[kind] += found
        silent[kind] += found and all(f.code != "model-misfit" for f in fit.findings)
    print(f"## {title}")
    for kind, count in every.items():
        print(f"{kind:34s} {alarms[kind]:3d} of {count:4d}, {silent[kind]} without model-misfit")
    total = every.total()
    share, cost = alarms.total() / total, checking / fitting
    print(f"all {alarms.total()} of {total}: {share:.2%}; {cost:.1%} of the fits' CPU", flush=True)


def main() -> None:
    """Print the false alarms, and the alarms of real logs."""
    records = int(sys.argv[1]) if len(sys.argv) > 1 else 42
    show("Records of the fitted kind", simulated(records, int(sys.argv[2]) if len(sys.argv) > 2 else 0))
    if data := os.environ.get("IMUCAL_REAL_DATA"):
        show("ADIS16405", measured(Path(data)))


if __name__ == "__main__":
    main()

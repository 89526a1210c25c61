"""Agreement of repeated measurements within their intervals, for real and simulated records.

    python tests/benchmarks/repeatability.py real [--model auto] [--segments 8 1]
    python tests/benchmarks/repeatability.py control --records 10 --seed 1 [--model auto]
    python tests/benchmarks/repeatability.py simulated --records 100 --seed 1 [--truth "N + B" …]

`real`: the quarters and halves of each run of the ADIS16405 (two runs of 1e6 samples at 100 Hz, six
axes), and both runs, from the folder IMUCAL_REAL_DATA. A pair disagrees if the score of its difference (as in
`imucal compare`) exceeds 1.96: 5 of 100 by chance; two bounds agree. Overdispersion is sqrt(chi2/dof) of the
logarithms of the detected terms: 1 by chance.

`control`: the same statistics by chance, for quarters of stationary simulations of the models that were
fitted to the complete runs; medians and 95 % ranges over the simulated sets.

`simulated`: stationary records, 33 min at 100 Hz: the number of axes with a widened interval, and the mean
increase of the intervals (logarithm of high over low; of the bound if there is none).
"""

import argparse
import itertools
import math
import os
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import imucal
from imucal.comparison import _score
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS
from tests.benchmarks.coverage_auto import RATE_HZ, TRUTHS, N

_REAL = Path(__file__).resolve().parents[3] / "shared" / "data"
#: rad/s and m/s² per count.
_GYRO, _ACCEL = 0.05 * math.pi / 180, 3.33e-3 * 9.80665
_PARTS = {"quarters": 4, "halves": 2, "runs": 1}


def real_axes() -> Iterator[tuple[str, int, imucal.AxisSeries]]:
    """Yield name, number of the run, and samples of each axis of both runs."""
    folder = Path(os.environ.get("IMUCAL_REAL_DATA", _REAL)) / "real" / "adis16405"
    for run in (1, 2):
        with np.load(folder / f"adis16405_run{run}.npz") as file:
            counts = {
                "gyroscope": file["gyro_counts"] * _GYRO,
                "accelerometer": file["accel_counts"] * _ACCEL,
            }
        for sensor, samples in counts.items():
            for axis, column in zip("xyz", samples.T, strict=True):
                name: imucal.recording.Axis = axis  # type: ignore[assignment] # one of three letters
                series = imucal.AxisSeries.from_samples(
                    column.copy(), rate_hz=100.0, sensor=sensor, axis=name
                )
                yield series.name, run, series


def parts_of(series: imucal.AxisSeries, count: int) -> list[imucal.AxisSeries]:
    """Return equal parts of a series."""
    ends = np.linspace(0, series.duration_s, count + 1)
    return [series.between(a, b) for a, b in itertools.pairwise(ends.tolist())]


def disagree(a: Estimate, b: Estimate, level: float) -> bool:
    """Whether two estimates of one number differ by more than chance explains."""
    score = _score(a, b, (level, level), 0.0)
    return score is not None and abs(score) > 1.96


def chi_squared(estimates: list[Estimate]) -> tuple[float, int]:
    """Return the chi-squared of logs about their mean in units of their errors, and degrees of freedom."""
    shown = [(e.value, e.low, e.high) for e in estimates if e.value and e.low > 0]
    if len(shown) < 2:
        return 0.0, 0
    logs = np.log([value for value, _, _ in shown])
    error = np.array([math.log(high / low) / (2 * 1.96) for _, low, high in shown])
    mean = np.average(logs, weights=error**-2)
    return float(np.sum(((logs - mean) / error) ** 2)), len(shown) - 1


def agreement(groups: list[list[NoiseFit]], symbol: str) -> tuple[float, int, float, int]:
    """Return the share of pairs that disagree, their number, the overdispersion, its degrees of freedom."""
    pairs = [
        disagree(a[symbol], b[symbol], a.level)
        for group in groups
        for a, b in itertools.combinations(group, 2)
    ]
    squares = [chi_squared([fit[symbol] for fit in group]) for group in groups]
    dof = sum(d for _, d in squares)
    over = math.sqrt(sum(s for s, _ in squares) / dof) if dof else math.nan
    return float(np.mean(pairs)), len(pairs), over, dof


def control(model: str, records: int, seed: int) -> None:
    """Print the results by chance, from stationary records of the fitted models."""
    models = [(imucal.fit(series, model=model).model, series.n) for _, _, series in real_axes()]
    found: dict[str, list[tuple[float, int, float, int]]] = {symbol: [] for symbol in ALWAYS}
    for record in range(records):
        groups = []
        for number, (truth, n) in enumerate(models):
            rng = np.random.default_rng([seed, record, number])
            samples = truth.simulate(n, rate_hz=RATE_HZ, rng=rng)
            series = imucal.AxisSeries.from_samples(samples, rate_hz=RATE_HZ)
            groups.append([imucal.fit(part, model=model) for part in parts_of(series, 4)])
        for symbol in ALWAYS:
            found[symbol].append(agreement(groups, symbol))
    cells = []
    for symbol in ALWAYS:
        shares = 100 * np.array([share for share, _, _, _ in found[symbol]])
        over = np.array([value for _, _, value, dof in found[symbol] if dof])
        dof = np.median([dof for _, _, _, dof in found[symbol]])
        spans = (np.quantile(values, [0.025, 0.5, 0.975]) for values in (shares, over) if values.size)
        intervals = " · ".join(f"{middle:.3g} ({low:.3g} to {high:.3g})" for low, middle, high in spans)
        cells.append(f"{intervals}, {dof:.0f} degrees of freedom")
    print(f"| quarters, {records} simulated sets | {' | '.join(cells)} |", flush=True)


def real(model: str, segments: int) -> None:
    """Print the table of the real records."""
    fits: dict[tuple[str, int, str], list[NoiseFit]] = {}
    for name, run, series in real_axes():
        for kind, count in _PARTS.items():
            parts = parts_of(series, count)
            fits[name, run, kind] = [imucal.fit(part, model=model, segments=segments) for part in parts]
    names = list(dict.fromkeys(name for name, _, _ in fits))
    for kind in _PARTS:
        groups = [fits[name, run, kind] for name in names for run in (1, 2)]
        if kind == "runs":
            groups = [fits[name, 1, kind] + fits[name, 2, kind] for name in names]
        cells = []
        for symbol in ALWAYS:
            share, pairs, over, dof = agreement(groups, symbol)
            widening = [fit[symbol].widening for group in groups for fit in group]
            cells.append(
                f"{100 * share:.0f} % of {pairs} · {over:.2f} of {dof} · "
                f"{np.median(widening):.2f}, {max(widening):.1f}"
            )
        print(f"| {kind}, segments {segments} | {' | '.join(cells)} |", flush=True)


def simulated(name: str, records: int, seed: int) -> None:
    """Print the row of one truth."""
    wider, seconds = [], 0.0
    growth: dict[str, list[float]] = {symbol: [] for symbol in ALWAYS}
    for record in range(records):
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), record])
        samples = NoiseModel.parse(TRUTHS[name]).simulate(N, rate_hz=RATE_HZ, rng=rng)
        series = imucal.AxisSeries.from_samples(samples, rate_hz=RATE_HZ)
        start = time.process_time()
        fit = imucal.fit(series)
        seconds += time.process_time() - start
        wider.append(any(e.widening > 1 for e in fit.estimates))
        for symbol in ALWAYS:
            growth[symbol].append(fit[symbol].widening)
    cells = [f"{100 * (np.mean(growth[symbol]) - 1):.1f} %" for symbol in ALWAYS]
    print(
        f"| {name} | {100 * np.mean(wider):.0f} | {' | '.join(cells)} | {seconds / records:.2f} |", flush=True
    )


def main() -> None:
    """Print a table in Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["real", "control", "simulated"])
    parser.add_argument("--model", default="auto")
    parser.add_argument("--segments", type=int, nargs="*", default=[1, 8])
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--truth", nargs="*", default=list(TRUTHS), choices=list(TRUTHS))
    options = parser.parse_args()
    if options.what == "real":
        heads = [f"{s}: pairs that disagree · overdispersion · widening, largest" for s in ALWAYS]
        print(f"| {options.model} | {' | '.join(heads)} |\n|{'---|' * 4}")
        for segments in options.segments:
            real(options.model, segments)
        return
    if options.what == "control":
        heads = [f"{s}: % of pairs that disagree · overdispersion" for s in ALWAYS]
        print(f"| {options.model} | {' | '.join(heads)} |\n|{'---|' * 4}")
        control(options.model, options.records, options.seed)
        return
    print(f"| truth | axes widened, of 100 | {' | '.join(f'{s} wider by' for s in ALWAYS)} | CPU s |")
    print(f"|{'---|' * 6}")
    for name in options.truth:
        simulated(name, options.records, options.seed)


if __name__ == "__main__":
    main()

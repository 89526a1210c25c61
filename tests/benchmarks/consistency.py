"""Consistency of a filter with the numbers of `filter_numbers`: its predicted and true errors.

    nice python -m tests.benchmarks.consistency [--file FITS.pkl] [--count 24] [--seed 2026] [--jobs 2]
    nice python -m tests.benchmarks.consistency --axes | --known | --real | --graph [--records 6] [--runs 200]

Without an option, 10 truths x 4 lengths x 24 records are fitted with the defaults: 0.2 CPU s each. The file
stores the fits, and another run continues. For each fit and each rule for two numbers, the script computes
the exact NEES of a filter of angle and bias that is aided at 1 Hz and then coasts 1 to 1000 s. The tables
contain the share of records with NEES > 1.2, the predicted divided by the true deviation, and the filter's
true error relative to the best rule.

`--axes`: one pair for three axes, from the same fits.

`--known`: the true model is covered, without a record; the worst NEES over many filters, and the price.

`--real`: both runs of the ADIS16405 (in the folder IMUCAL_REAL_DATA): one part is fitted and another one
checked, by the filter's error on its samples and by its Allan variance.

`--graph`: a factor graph of GTSAM, if installed, aided in attitude at 1 Hz for 5 minutes, then coasting for
60 s, with simulated errors.

The tables are those of docs/results/consistency.md, in Markdown.
"""

import argparse
import importlib.util
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

import imucal
from imucal import AxisSeries, NoiseModel
from imucal.arrays import FloatArray
from imucal.fitting import NoiseFit
from imucal.fitting.noise_fit import Estimate, Interval
from imucal.prediction import filter_numbers
from tests.benchmarks.aided_filter import COASTS_S, Aiding, coasting, errors, nees, weights
from tests.benchmarks.consistency_records import LENGTHS, TRUTHS, Record, fits
from tests.benchmarks.repeatability import parts_of, real_axes

__all__ = ["RULES", "as_fitted", "covered", "known_fit"]

Rule: TypeAlias = Callable[[NoiseFit], tuple[float, float]]

#: Filters above this NEES are overconfident: their predicted deviation is a tenth too small.
TOO_SURE = 1.2
#: Limit for real records, where the check itself has noise.
TOO_SURE_REAL = 1.5
#: Additional truths for `known`, which two numbers describe poorly.
HARD = {
    "B = 3 N": "N=1e-3 + B=3e-3",
    "N + GM, 20 s, large": "N=1e-3 + GM(sigma=5e-3, T=20)",
    "N + B + R": "N=1e-3 + B=3e-4 + R=5e-7",
    "Q large": "Q=3e-3 + N=1e-3 + K=3e-5",
}


def as_fitted(fit: NoiseFit) -> tuple[float, float]:
    """Return N and K of the fit, or the bound of an undetected one."""
    N, K = (fit[symbol].value or fit[symbol].high for symbol in "NK")
    return N, K


def covered(fit: NoiseFit) -> tuple[float, float]:
    """Return the pair that covers the fitted spectrum."""
    pair = filter_numbers([fit])
    return pair.white, pair.walk


def covered_to_a_minute(fit: NoiseFit) -> tuple[float, float]:
    """Return the pair for a horizon of 60 s, as in exports for cameras and lidars."""
    pair = filter_numbers([fit], horizon_s=60.0)
    return pair.white, pair.walk


def by_habit(fit: NoiseFit) -> tuple[float, float]:
    """Return ten times N and K."""
    N, K = as_fitted(fit)
    return 10 * N, 10 * K


def curve_covered(fit: NoiseFit) -> tuple[float, float]:
    """Return the pair that covers the upper limits of the Allan curve, without a model."""
    return covered(imucal.fit(fit.curve, method="slope"))


def allan_variance_ros(fit: NoiseFit) -> tuple[float, float]:
    """Return that tool's two lines: slope -1/2 through tau of 0.1 to 10 s, +1/2 through 0.1 to 1000 s.

    They are fitted to the overlapping curve; the tool's own curve has disjoint averages at each 0.1 s.
    """
    tau, adev = fit.curve.tau, fit.curve.adev
    at = np.arange(max(0.1, tau[0]), min(1000.0, tau[-1]), 0.1)
    logs = np.log(np.interp(at, tau, adev))
    early = at <= 10
    white = np.mean(logs[early] + 0.5 * np.log(at[early]))
    walk = np.mean(logs - 0.5 * np.log(at)) + 0.5 * np.log(3)
    return float(np.exp(white)), float(np.exp(walk))


def reading(fit: NoiseFit) -> tuple[float, float]:
    """Return values read from the curve: at 1 s, and a line of slope +1/2 beyond twice the minimum's tau."""
    tau, adev = fit.curve.tau, fit.curve.adev
    white = float(np.interp(1.0, tau, adev))
    late = tau >= 2 * tau[np.argmin(adev)]
    if np.count_nonzero(late) < 3:
        return white, 0.0
    return white, float(np.exp(np.mean(np.log(adev[late]) - 0.5 * np.log(tau[late]))) * np.sqrt(3))


RULES: dict[str, Rule] = {
    "N and K of the fit": as_fitted,
    "covered pair": covered,
    "covered pair, horizon 60 s": covered_to_a_minute,
    "covered curve, no model": curve_covered,
    "lines of allan_variance_ros": allan_variance_ros,
    "read off the curve (AllanTools)": reading,
    "ten times N and K": by_habit,
}


def row(name: str, cells: Sequence[object]) -> None:
    """Print a row of a table."""
    print(f"| {name} | {' | '.join(map(str, cells))} |", flush=True)


def head(name: str, columns: Sequence[str] | None = None) -> None:
    """Print the head of a table; by default its columns are the coasts."""
    columns = columns or ["aided", *(f"{coast} s" for coast in COASTS_S[1:])]
    row(name, columns)
    row("---", ["---"] * len(columns))


def percents(shares: FloatArray) -> list[str]:
    """Return shares as percentages."""
    return [f"{100 * share:.1f}" for share in shares]


def ratios(logs: FloatArray) -> list[str]:
    """Return the geometric means of rows of logarithms."""
    return [f"{value:.2f}" for value in np.exp(logs.mean(axis=0))]


def records(every: Mapping[Record, NoiseFit], count: int, seed: int) -> None:
    """Print the tables of single axes."""
    cells = list(itertools.product(TRUTHS, LENGTHS))
    shape = (len(RULES), len(cells), count, len(COASTS_S))
    predicted, true = np.empty(shape), np.empty(shape)
    for i, (truth, length) in enumerate(cells):
        own = [(record, fit) for record, fit in every.items() if record[:2] == (truth, length)]
        pairs = np.array([rule(fit) for rule in RULES.values() for _, fit in own])
        found = errors(pairs, own[0][0].model, rate_hz=own[0][0].rate_hz)
        predicted[:, i], true[:, i] = (each.reshape(len(RULES), count, -1) for each in found)
    over = true / predicted > TOO_SURE
    logs = np.log(predicted / true) / 2
    print(f"\nNEES > {TOO_SURE}, % of {len(cells) * count} records, seed {seed}\n")
    head("rule")
    for name, each in zip(RULES, over, strict=True):
        row(name, percents(each.mean(axis=(0, 1))))
    print("\nPredicted over true deviation, geometric mean\n")
    head("rule")
    for name, log in zip(RULES, logs, strict=True):
        row(name, ratios(log.reshape(-1, len(COASTS_S))))
    print("\nTrue deviation over that of the best of these rules: mean, 95 of 100\n")
    head("rule")
    for name, each in zip(RULES, np.sqrt(true / true.min(axis=0)), strict=True):
        flat = each.reshape(-1, len(COASTS_S))
        both = zip(flat.mean(axis=0), np.quantile(flat, 0.95, axis=0), strict=True)
        row(name, [f"{mean:.2f}, {high:.2f}" for mean, high in both])
    print("\nThe covered pair by truth and by length: predicted over true deviation (NEES > 1.2, %)\n")
    head("records")
    place = list(RULES).index("covered pair")
    for axis, names in enumerate((list(TRUTHS), list(LENGTHS))):
        for name in names:
            chosen = [i for i, cell in enumerate(cells) if cell[axis] == name]
            shares = percents(over[place, chosen].mean(axis=(0, 1)))
            means = ratios(logs[place, chosen].reshape(-1, len(COASTS_S)))
            row(name, [f"{mean} ({share})" for mean, share in zip(means, shares, strict=True)])


def triads(every: Mapping[Record, NoiseFit], count: int, seed: int) -> None:
    """Print the tables of one pair for three axes: with one truth, and with three different truths."""
    rng = np.random.default_rng(seed)
    same = [
        [Record(truth, length, 3 * i + axis, seed) for axis in range(3)]
        for truth, length in itertools.product(TRUTHS, LENGTHS)
        for i in range(min(3, count // 3))
    ]
    mixed = [
        [Record(truth, length, int(rng.integers(count)), seed) for truth in rng.permutation(list(TRUTHS))[:3]]
        for length in LENGTHS
        for _ in range(30)
    ]
    for label, groups in (("of one truth", same), ("of three truths", mixed)):
        # Shape (triads, axes, rules, coasts).
        found = np.array([_of_triad([(record, every[record]) for record in group]) for group in groups])
        print(f"\n{len(groups)} triads {label}: % with NEES > {TOO_SURE} on any axis", end="")
        print(" (predicted over true deviation)\n")
        head("rule")
        for rule, name in enumerate(("N and K, the largest of three", "covered pair")):
            shares = percents((found[:, :, rule].max(axis=1) > TOO_SURE).mean(axis=0))
            means = ratios(-np.log(found[:, :, rule]).reshape(-1, len(COASTS_S)) / 2)
            row(name, [f"{share} ({mean})" for share, mean in zip(shares, means, strict=True)])


def _of_triad(axes: list[tuple[Record, NoiseFit]]) -> list[FloatArray]:
    """Return the NEES of each axis with the largest N and K, and with the pair for all three."""
    own = [fit for _, fit in axes]
    pair = filter_numbers(own)
    pairs = np.array([np.max([as_fitted(fit) for fit in own], axis=0), (pair.white, pair.walk)])
    return [nees(pairs, record.model, rate_hz=record.rate_hz) for record, _ in axes]


def known_fit(text: str) -> NoiseFit:
    """Return a fit whose model is known exactly."""
    samples = np.random.default_rng(1).standard_normal(2000)
    fit = imucal.fit(AxisSeries.from_samples(samples, rate_hz=20.0, sensor="gyroscope", axis="x"), model="N")
    estimates = []
    for i, term in enumerate(NoiseModel.parse(text).terms):
        value, time = term.coefficient, getattr(term, "T", None)
        estimates.append(
            Estimate(
                key=f"{term.symbol}{i}",
                symbol=term.symbol,
                status="estimated",
                value=value,
                low=value,
                high=value,
                correlation_time=time and Interval(value=time, low=time, high=time),
            )
        )
    return replace(
        fit,
        model=NoiseModel.parse(text),
        estimates=tuple(estimates),
        parameters=(),
        covariance=np.zeros((0, 0)),
    )


def known() -> None:
    """Print the worst NEES over filters if the true model is covered."""
    print(
        "\nWorst NEES over angles of 0.1 to 100 mrad and 60 to 2000 updates (predicted over true deviation)\n"
    )
    head("truth")
    for name, text in (TRUTHS | HARD).items():
        pair = np.array([covered(known_fit(text))])
        found = np.array(
            [
                nees(pair, NoiseModel.parse(text), rate_hz=20.0, aiding=Aiding(sd, updates))[0]
                for sd in (1e-4, 1e-3, 1e-2, 1e-1)
                for updates in (60, 300, 2000)
            ]
        )
        price = ratios(-np.log(found) / 2)
        row(name, [f"{worst:.2f} ({each})" for worst, each in zip(found.max(axis=0), price, strict=True)])


def real() -> None:
    """Print for how many parts of real records the numbers of another part are overconfident."""
    print(f"\nObserved over predicted variance at 60 s: > {TOO_SURE_REAL}, % (median, largest)\n")
    rules = {"N and K": as_fitted, "pair": covered, "curve": curve_covered}
    ways = [f"{name}, {way}" for name in rules for way in ("its filter", "Allan variance")]
    head("fitted, checked", ["sensor", "pairs", *ways])
    runs: dict[tuple[str, int], AxisSeries] = {(name, run): series for name, run, series in real_axes()}
    for label, choose in _CHOICES.items():
        found: dict[str, list[list[float]]] = {}
        for fitted, checked in choose(runs):
            fit = imucal.fit(fitted)
            ratio = [each for rule in rules.values() for each in observed(rule(fit), checked)]
            found.setdefault(str(fitted.sensor), []).append(ratio)
        for sensor, table in found.items():
            cells = [
                f"{100 * np.mean(values > TOO_SURE_REAL):.0f} ({np.median(values):.2f}, {values.max():.2f})"
                for values in np.array(table).T
            ]
            row(label, [sensor, len(table), *cells])


def _halves(runs: dict[tuple[str, int], AxisSeries]) -> Iterator[tuple[AxisSeries, AxisSeries]]:
    for series in runs.values():
        yield from itertools.permutations(parts_of(series, 2))


def _quarters(runs: dict[tuple[str, int], AxisSeries]) -> Iterator[tuple[AxisSeries, AxisSeries]]:
    for series in runs.values():
        yield from itertools.pairwise(parts_of(series, 4))


def _other_run(runs: dict[tuple[str, int], AxisSeries]) -> Iterator[tuple[AxisSeries, AxisSeries]]:
    for (name, run), series in runs.items():
        yield series, runs[name, 3 - run]


_CHOICES = {
    "one half, the other": _halves,
    "a quarter, the next": _quarters,
    "one run, the other": _other_run,
}


def observed(pair: tuple[float, float], series: AxisSeries, coast_s: int = 60) -> tuple[float, float]:
    """Return observed over predicted variance: of the filter's error over the record, and of its curve.

    The filter is aided 300 times with an angle of twice N. Its weights are applied to all seconds of the
    record; those of the curve are -1 and 1 over a coast: the mean of one span predicts the next.
    """
    N, K = pair
    whole = round(series.rate_hz)
    seconds = np.asarray(series.samples, dtype=np.float64)
    seconds = seconds[: seconds.size // whole * whole].reshape(-1, whole).mean(axis=1)
    aiding = Aiding(2 * N, 300)
    found = weights(np.array([pair]), aiding, [coast_s])
    rows, on_angles = coasting(found, coast_s)
    moved = np.correlate(seconds - seconds.mean(), rows[0], mode="valid")
    filtered = float(np.mean(moved**2) + aiding.sd**2 * on_angles[0]) / float(found.predicted[0, 0])
    step = np.concatenate([-np.ones(coast_s), np.ones(coast_s)])
    second = float(np.mean(np.correlate(seconds, step, mode="valid") ** 2)) / (2 * coast_s**2)
    return filtered, second / (N**2 / coast_s + K**2 * coast_s / 3)


def graph(count: int, runs: int, seed: int) -> None:
    """Print the NEES of GTSAM's attitude."""
    if importlib.util.find_spec("gtsam") is None:
        print("gtsam is not installed here; pip install gtsam")
        return
    from tests.benchmarks.attitude_graph import attitude_nees

    attitude_nees(
        {"N and K of the fit": as_fitted, "covered pair": covered}, count=count, runs=runs, seed=seed
    )


def main() -> None:
    """Print the requested tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = parser.add_mutually_exclusive_group()
    for name in ("axes", "known", "real", "graph"):
        what.add_argument(f"--{name}", action="store_const", const=name, dest="what")
    parser.add_argument("--file", type=Path, default=Path("consistency-fits.pkl"), help="keeps the fits")
    parser.add_argument("--count", type=int, default=24, help="records of a truth and length")
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--records", type=int, default=6, help="fits of --graph")
    parser.add_argument("--runs", type=int, default=200, help="coasts of --graph a fit")
    asked = parser.parse_args()
    if asked.what == "known":
        known()
    elif asked.what == "real":
        real()
    elif asked.what == "graph":
        graph(asked.records, asked.runs, asked.seed)
    else:
        every = fits(asked.file, count=asked.count, seed=asked.seed, jobs=asked.jobs)
        (triads if asked.what == "axes" else records)(every, asked.count, asked.seed)


if __name__ == "__main__":
    main()

"""Other tools that estimate N, B and K, on records of known truth: errors, coverage and CPU time.

    python -m tests.benchmarks.peers --records 20

It prints the tables of docs/results/comparison.md in Markdown, seed 120 and up, in five minutes on one core.
One process runs all tools on the same samples. The recipes of `allan_variance_ros`, `imu_utils` and
`kalibr_allan` are reimplemented from their sources; differences of the solver are documented. R's gmwm is
omitted, because Debian has no package of it.
"""

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

import allantools
import numpy as np
from scipy.optimize import least_squares

import imucal
from imucal import AxisSeries, NoiseModel
from imucal.arrays import FloatArray

__all__ = ["TOOLS", "TRUTHS", "Reading", "deviations", "measure"]

#: Height of a flicker floor over B.
_FLOOR = math.sqrt(2 * math.log(2) / math.pi)
#: Absent coefficients below this limit, N/1000, do not count as false.
_NOTHING = 1e-6
#: Degrees per hour in a rad/s, as defined by imu_utils.
_DEG_H = 57.3 * 3600
RATE_HZ = 100.0

#: Name -> true model.
TRUTHS = {
    "white": "N=1e-3",
    "N + K": "N=1e-3 + K=1e-4",
    "N + B + K": "N=1e-3 + B=3e-4 + K=3e-5",
    "N + GM + K": "N=1e-3 + GM(sigma=5e-4, T=20) + K=3e-5",
}


@dataclass(frozen=True)
class Reading:
    """Results of a tool for one record: coefficients by symbol, and intervals if available."""

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)


Tool: TypeAlias = Callable[[FloatArray], Reading]


def deviations(samples: FloatArray, m: FloatArray, *, overlapping: bool) -> FloatArray:
    """Return Allan deviations at averages of `m` samples, with all second differences or every m-th."""
    angle = np.concatenate([[0.0], np.cumsum(samples)])
    found = []
    for each in m.astype(int):
        second = angle[2 * each :] - 2 * angle[each:-each] + angle[: -2 * each]
        found.append(np.sqrt(np.mean(second[:: 1 if overlapping else each] ** 2) / 2) / each)
    return np.array(found)


def _line(tau: FloatArray, adev: FloatArray, slope: float, at: float, slack: float = 0.0) -> float:
    """Return the value at `at` of the least-squares line in logarithms, of `slope` to `slope + slack`."""
    x, y = np.log(tau), np.log(adev)
    best = float(np.cov(x, y, bias=True)[0, 1] / np.var(x)) if slack else slope
    slope = min(max(best, slope), slope + slack)
    return float(np.exp(np.mean(y - slope * x) + slope * math.log(at)))


def allantools_script(samples: FloatArray) -> Reading:
    """Estimate like scripts: `oadev`, lines where the slope is nearest -1/2 and +1/2, minimum/0.664."""
    tau, adev, _, _ = allantools.oadev(samples, rate=RATE_HZ, data_type="freq", taus="octave")
    slopes = np.diff(np.log(adev)) / np.diff(np.log(tau))
    white, walk = int(np.argmin(np.abs(slopes + 0.5))), int(np.argmin(np.abs(slopes - 0.5)))
    return Reading(
        {
            "N": float(adev[white] * math.sqrt(tau[white])),
            "B": float(adev.min() / _FLOOR),
            "K": float(adev[walk] * math.sqrt(3 / tau[walk])),
        }
    )


def allan_variance_ros(samples: FloatArray) -> Reading:
    """ori-drs/allan_variance_ros: disjoint averages of 0.1 to 999.9 s, lines over tau < 10 s and over all."""
    longest = len(samples) / RATE_HZ / 2
    every = 0.1 * np.arange(1.0, 10_000.0).astype(np.float64)
    tau: FloatArray = every[every <= longest]
    adev = deviations(samples, np.round(tau * RATE_HZ), overlapping=False)
    early = tau < 10 - 1e-9
    return Reading(
        {
            "N": _line(tau[early], adev[early], -0.5, 1.0, 0.001),
            "B": float(adev.min()),
            "K": _line(tau, adev, 0.5, 3.0, 0.001),
        }
    )


def imu_utils(samples: FloatArray) -> Reading:
    """gaowenliang/imu_utils: overlapping, 100 times, least squares of log10 of five powers of tau.

    Its solver is Ceres' dogleg with 50 iterations; here it is SciPy's Levenberg-Marquardt, same start.
    """
    longest = 2 ** int(math.log2(len(samples) // 2))
    m = np.unique(np.ceil(np.geomspace(1, longest, 100) - 1e-9))
    tau = m / RATE_HZ
    adev = deviations(samples * _DEG_H, m, overlapping=True)
    powers = np.stack([tau**k for k in (-2.0, -1.0, 0.0, 1.0, 2.0)], axis=1)
    start = np.abs(np.linalg.lstsq(np.sqrt(powers), adev, rcond=None)[0])
    wanted = 2 * np.log10(adev)

    def missed(p: FloatArray) -> FloatArray:
        return np.asarray(np.log10(powers @ p**2) - wanted)

    found = least_squares(missed, start, method="lm", ftol=1e-6, max_nfev=50 * 6).x
    white, flat, walk = np.abs(found[1:4]) / _DEG_H
    return Reading({"N": white, "B": flat / _FLOOR, "K": math.sqrt(3) * walk})


def kalibr_allan(samples: FloatArray) -> Reading:
    """rpng/kalibr_allan: disjoint averages at 2000 times, lines 50 points away from the minimum."""
    period, longest = 1 / RATE_HZ, (len(samples) - 1) // 2
    m = np.floor(np.logspace(math.log10(period), math.log10(longest), 2000) + 1e-9)
    distinct, back = np.unique(np.maximum(m, 1), return_inverse=True)
    adev = deviations(samples, distinct, overlapping=False)[back][m >= 1]
    tau = m[m >= 1] * period
    low = int(np.argmin(adev))
    values = {"N": _line(tau[: low - 50], adev[: low - 50], -0.5, 1.0)} if low > 50 else {}
    right = slice(low + 50, None)
    if len(tau[right]):
        values["K"] = _line(tau[right], adev[right], 0.5, 3.0)
    return Reading(values)


def imucal_fit(samples: FloatArray) -> Reading:
    """Fit like `imucal fit`: the model is chosen, and an undetected term has an upper bound."""
    fit = imucal.fit(AxisSeries.from_samples(samples, rate_hz=RATE_HZ, sensor="gyroscope", axis="x"))
    estimates = {symbol: fit[symbol] for symbol in "NBK"}
    return Reading(
        {symbol: each.value for symbol, each in estimates.items() if each.value is not None},
        {symbol: (each.low, each.high) for symbol, each in estimates.items()},
    )


TOOLS: dict[str, Tool] = {
    "AllanTools script": allantools_script,
    "allan_variance_ros": allan_variance_ros,
    "imu_utils": imu_utils,
    "kalibr_allan": kalibr_allan,
    "imucal": imucal_fit,
}


def measure(name: str, tools: dict[str, Tool], *, records: int, n: int, seed: int) -> list[str]:
    """Return the rows of one table: every tool on the same records."""
    truth = NoiseModel.parse(TRUTHS[name])
    true = {term.symbol: term.coefficient for term in truth.terms if term.symbol in "NBK"}
    readings: dict[str, list[Reading]] = {tool: [] for tool in tools}
    seconds = dict.fromkeys(tools, 0.0)
    rng = np.random.default_rng(seed)
    for _ in range(records):
        samples = truth.simulate(n, rate_hz=RATE_HZ, rng=rng)
        for tool, read in tools.items():
            begin = time.process_time()
            readings[tool].append(read(samples))
            seconds[tool] += time.process_time() - begin
    rows = []
    for tool, found in readings.items():
        cells = " | ".join(_cell(found, symbol, true.get(symbol)) for symbol in "NBK")
        rows.append(f"| {tool} | {cells} | {_coverage(found, true)} | {seconds[tool] / records:.2g} |")
    return rows


def _cell(found: list[Reading], symbol: str, true: float | None) -> str:
    """Return mean error and spread in %, and the number of estimates; or the number of false ones."""
    values = np.array([each.values[symbol] for each in found if each.values.get(symbol, 0.0) > 0])
    if not any(symbol in each.values or symbol in each.intervals for each in found):
        return "–"
    if true is None:
        values = values[values > _NOTHING]
        where = f", median {np.median(values):.1e}" if len(values) else ""
        return f"{len(values)} of {len(found)} false{where}"
    share = "" if len(values) == len(found) else f" ({len(values)} of {len(found)})"
    if not len(values):
        return f"bounded, 0 of {len(found)}"
    error = 100 * (values / true - 1)
    spread = f" ± {error.std(ddof=1):.2g}" if len(values) > 1 else ""
    return f"{error.mean():+.2g}{spread} %{share}"


def _coverage(found: list[Reading], true: dict[str, float]) -> str:
    """Return the number of intervals of N, B and K that cover the truth, which is 0 for absent terms."""
    if not found[0].intervals:
        return "none"
    parts = []
    for symbol in "NBK":
        limits = [each.intervals[symbol] for each in found]
        held = sum(low <= true.get(symbol, 0.0) <= high for low, high in limits)
        parts.append(f"{symbol} {held}")
    return f"{', '.join(parts)} of {len(found)}"


def main() -> None:
    """Print one table per truth."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=20)
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=120)
    options = parser.parse_args()
    imucal_fit(np.random.default_rng(0).standard_normal(5000))  # imports are not of the first record
    for i, (name, model) in enumerate(TRUTHS.items()):
        print(f"\n**{name}**: `{model}`, {options.records} records, seed {options.seed + i}\n")
        print("| tool | N | B | K | intervals that hold the truth | CPU s |\n|---|---|---|---|---|---|")
        for row in measure(name, TOOLS, records=options.records, n=options.samples, seed=options.seed + i):
            print(row, flush=True)


if __name__ == "__main__":
    main()

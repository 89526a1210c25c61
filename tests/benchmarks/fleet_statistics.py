"""Coverage of the population's numbers: median, spreads, tolerance bound, prediction and odd units.

    python tests/benchmarks/fleet_statistics.py --fleets 100 --seed 5

Each row is a kind of fleet: units × logs per unit, spread between units tau, relative error of an estimate
(of the variance for weak terms), scatter within a unit omega. Bias of the median and coverage are in %;
``not told`` are fleets whose median unit is only bounded.
"""

import argparse
import math
import time
import warnings

import numpy as np
from scipy.special import ndtr, ndtri

from imucal.fleet.population import Population, population
from imucal.fleet.values import LogValue
from tests.fleet.simulated import strong_fleet, weak_fleet

#: Kind, units, logs, tau, error, omega.
ROWS = (
    ("strong", 5, 1, 0.3, 0.006, 0.0),
    ("strong", 50, 1, 0.3, 0.006, 0.0),
    ("strong", 10, 1, 0.1, 0.15, 0.0),
    ("weak, likelihood", 50, 1, 0.3, 0.8, 0.0),
    ("weak, limits only", 50, 1, 0.3, 0.8, 0.0),
    ("weak, likelihood", 10, 6, 0.3, 0.8, 0.0),
    ("strong", 10, 4, 0.2, 0.05, 0.15),
    ("weak, likelihood", 10, 1, 0.3, 0.8, 0.0),
    ("weak, likelihood", 10, 2, 0.3, 3.0, 0.0),
    ("weak, likelihood", 6, 2, 0.1, 3.0, 0.0),
    ("weak, likelihood", 10, 1, 0.6, 1.0, 0.0),
    ("weak, likelihood", 24, 3, 0.1, 8.0, 0.0),
    ("weak, likelihood", 24, 3, 0.3, 2.8, 0.0),
)


def simulate(rng: np.random.Generator, row: tuple[str, int, int, float, float, float]) -> list[LogValue]:
    """Return one fleet of a row."""
    kind, units, logs, tau, error, omega = row
    if kind == "strong":
        return strong_fleet(rng, units=units, logs=logs, tau=tau, error=error, omega=omega)
    likelihood = kind == "weak, likelihood"
    return weak_fleet(rng, units=units, logs=logs, tau=tau, error=error, likelihood=likelihood)


def outcome(found: Population, tau: float, omega: float) -> list[float]:
    """Return the contribution of one fleet to its row."""
    bound = math.exp(float(ndtri(0.95)) * tau)
    low, high = np.log(np.maximum(found.prediction or (1.0, 1.0), 1e-99)) / tau
    spread, within = found.spread, found.within
    return [
        np.mean([unit.value is None for unit in found.units]),
        math.nan if found.bounded else math.log(found.median.value),
        found.median.low <= 1 <= found.median.high,
        spread.value / tau if spread else math.nan,
        spread.low <= tau <= spread.high if spread else math.nan,
        (found.tolerance or 0.0) >= bound,
        (found.tolerance or 0.0) / bound,
        ndtr(high) - ndtr(low),
        within.low <= omega <= within.high if within else math.nan,
        any(unit.odd for unit in found.units),
        found.bounded,
    ]


def main() -> None:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fleets", type=int, default=100)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--rows", type=int, nargs="*", default=range(len(ROWS)), help="which, from 0")
    options = parser.parse_args()
    print(
        "| fleet (units × logs, tau, error, omega) | bounded | median: bias, cover | tau ratio, cover "
        "| 95/95 cover, ÷ true quantile | prediction | omega cover | odd alarms | not told | ms |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for place in options.rows:
        row = ROWS[place]
        kind, units, logs, tau, error, omega = row
        rng = np.random.default_rng([options.seed, place])
        start = time.process_time()
        fleets = (simulate(rng, row) for _ in range(options.fleets))
        table = np.array([outcome(population(fleet), tau, omega) for fleet in fleets], dtype=float)
        spent = 1e3 * (time.process_time() - start) / options.fleets
        with warnings.catch_warnings():
            # A row may have no fleet with a number.
            warnings.simplefilter("ignore", RuntimeWarning)
            mean, middle = np.nanmean(table, axis=0), np.nanmedian(table, axis=0)
        print(
            f"| {kind} {units}×{logs}, {tau}, {error}, {omega} | {100 * mean[0]:.0f} "
            f"| {100 * mean[1]:+.1f}, {100 * mean[2]:.0f} | {middle[3]:.2f}, {100 * mean[4]:.0f} "
            f"| {100 * mean[5]:.0f}, {middle[6]:.2f} | {100 * mean[7]:.1f} | {100 * mean[8]:.0f} "
            f"| {100 * mean[9]:.0f} | {100 * mean[10]:.0f} | {spent:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()

"""False alarms and power of what is said to move with temperature and time, over many simulated fleets.

    python tests/benchmarks/fleet_trends.py --fleets 200 --seed 7

A fleet has four terms, each with its own draws, recorded on the same days at the same temperatures; what
moves is looked for in all of them at once. Logs lie at random days of a year, at 15 to 35 °C.
``alone`` counts fleets in which a unit is said to move as no other, ``fleet`` those in which the whole fleet
is said to; without any trend both are false. Power: unit u0 moves in all terms, or all units do, each 20 %
otherwise.
"""

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from imucal.errors import DataError
from imucal.fleet import LogValue, Trend, trend
from imucal.fleet.trend import adjust

Z = float(ndtri(0.975))
TERMS = 4
#: Units and logs a unit; standard error of a log (negative: of the variance, for weak terms); scatter.
FLEETS = ((10, 4), (20, 4), (24, 3), (8, 10))
ERRORS = (0.006, 0.05, 0.15, -0.8)
OMEGAS = (0.0, 0.15)
#: What moves, the logarithm a day and a °C, and whether alone.
MOVES = (("drift", 0.1 / 100, 0.0), ("heat", 0.0, 0.01))


def make_fleet(
    rng: np.random.Generator,
    shape: tuple[int, int],
    error: float,
    omega: float,
    *,
    day: float = 0.0,
    celsius: float = 0.0,
    alone: bool = False,
) -> list[list[LogValue]]:
    """Return the logs of each term; `error` below zero is that of the squared coefficient of a weak term."""
    units, logs = shape
    days, heat = rng.uniform(0, 365, shape), rng.uniform(15, 35, shape)
    found = []
    for _ in range(TERMS):
        y = 0.2 * rng.standard_normal((units, 1)) + omega * rng.standard_normal(shape)
        moves = 1 + 0.2 * rng.standard_normal((2, units, 1))
        if alone:
            moves[:] = np.arange(units)[:, None] == 0
        y = y + day * moves[0] * days + celsius * moves[1] * (heat - 25)
        found.append(
            [
                replace(one_log(rng, f"u{u}", y[u, i], error), days=days[u, i], temperature_c=heat[u, i])
                for u in range(units)
                for i in range(logs)
            ]
        )
    return found


def one_log(rng: np.random.Generator, unit: str, y: float, error: float) -> LogValue:
    """Return what a log says of a term whose logarithm is `y`."""
    if error > 0:
        value = math.exp(y + error * rng.standard_normal())
        return LogValue(
            unit=unit, value=value, low=value * math.exp(-Z * error), high=value * math.exp(Z * error)
        )
    sd = -error
    square = math.exp(2 * y) + sd * rng.standard_normal()
    low2 = square - Z * sd
    weak = square < 3 * sd
    return LogValue(
        unit=unit,
        value=math.sqrt(square) if low2 > 0 else None,
        low=math.sqrt(max(low2, 0.0)),
        high=math.sqrt(max(square, 0.0) + Z * sd),
        variance=square if weak else None,
        variance_sd=sd if weak else None,
    )


def trends(fleet: Sequence[Sequence[LogValue]]) -> tuple[Trend, ...]:
    """Return the trends of a fleet's terms, judged together; those that tell none are left out."""
    found = []
    for logs in fleet:
        try:
            found.append(trend(logs))
        except DataError:
            continue
    return adjust(found)


def said(fleet: Sequence[Sequence[LogValue]]) -> tuple[float, ...]:
    """Return whether some unit, unit u0 and the fleet move; and how often mean slopes of zero are held."""
    found = trends(fleet)
    means = [mean for one in found for mean in one.means]
    odd = {slope.unit for one in found for slope in one.slopes if slope.odd}
    held = [mean.slope.low <= 0 <= mean.slope.high for mean in means]
    own = [slope.slope.low <= 0 <= slope.slope.high for one in found for slope in one.slopes]
    share = [float(np.mean(part)) if part else math.nan for part in (held, own)]
    return float(bool(odd)), "u0" in odd, any(mean.odd for mean in means), *share


def main() -> None:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fleets", type=int, default=200)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--no-power", action="store_true")
    parser.add_argument("--rows", type=int, nargs="*", help="which, from 0; all by default")
    options = parser.parse_args()
    print(
        "| fleet | error | omega | no trend: alone, fleet, mean and own slopes held "
        "| one unit 10 %/100 days | one unit 1 %/°C | all 10 %/100 days | all 1 %/°C | ms |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    rows = [(shape, error, omega) for shape in FLEETS for error in ERRORS for omega in OMEGAS]
    for place in range(len(rows)) if options.rows is None else options.rows:
        shape, error, omega = rows[place]
        rng = np.random.default_rng([options.seed, place])
        start = time.process_time()
        none = [said(make_fleet(rng, shape, error, omega)) for _ in range(options.fleets)]
        share = 100 * np.nanmean(np.array(none, dtype=float), axis=0)
        spent = 1e3 * (time.process_time() - start) / (options.fleets * TERMS)
        cells = []
        for alone in (True, False) if not options.no_power else ():
            for _, day, celsius in MOVES:
                found = [
                    said(make_fleet(rng, shape, error, omega, day=day, celsius=celsius, alone=alone))
                    for _ in range(max(options.fleets // 5, 1))
                ]
                cells.append(f"{100 * np.mean([one[1 if alone else 2] for one in found]):.0f}")
        print(
            f"| {shape[0]}×{shape[1]} | {error} | {omega} | {share[0]:.1f}, {share[2]:.1f}, {share[3]:.1f}, "
            f"{share[4]:.1f} | {' | '.join(cells)} | {spent:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()

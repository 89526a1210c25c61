"""Coverage of a fleet's numbers with real fits: records are simulated, binned, fitted, and pooled.

    python -m tests.benchmarks.fleet_fits --fleets 100 --seed 7301

Each row is a term of a kind of fleet: every unit has its own coefficients, with a spread of ``tau`` about
the truth, and every log is a record at 100 Hz. ``told by`` is the squared truth divided by the standard
error of one log's square. The bias of the median, in %, is over the fleets that detect it. Coverage is in %,
with bounds as intervals from zero. ``error`` is the scatter of the medians divided by their mean interval
(1.96 standard errors to each side).
"""

import argparse
import math
import multiprocessing
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

import imucal
from imucal.fleet.population import Population, population
from imucal.fleet.values import LogValue, log_values
from tests.fleet.records import RATE, quick_fit


@dataclass(frozen=True)
class Kind:
    """A kind of fleet: coefficients of its median unit in SI, and number and length of records."""

    truth: dict[str, float]
    samples: int
    units: int
    logs: int
    tau: float

    @property
    def title(self) -> str:
        """Title of a row."""
        terms = " + ".join(f"{key} {value:g}" for key, value in self.truth.items())
        return f"{terms}; {self.units}×{self.logs} of {self.samples}, {self.tau:g}"


KINDS = (
    Kind({"N": 9e-5, "K": 1e-4}, 4000, 24, 1, 0.1),
    Kind({"N": 9e-5, "K": 1e-4}, 4000, 8, 4, 0.2),
    Kind({"N": 9e-5, "K": 3e-5}, 4000, 24, 1, 0.1),
    Kind({"N": 9e-5, "K": 1e-4}, 20_000, 10, 1, 0.3),
    Kind({"N": 1e-4, "B": 3e-5}, 20_000, 24, 1, 0.1),
    Kind({"N": 1e-4, "B": 1e-4}, 20_000, 10, 1, 0.2),
    Kind({"N": 1e-4, "B": 3e-5, "K": 1e-5}, 20_000, 24, 2, 0.2),
    Kind({"N": 1e-4, "B": 1e-4, "K": 3e-5}, 20_000, 24, 1, 0.2),
    Kind({"N": 9e-5}, 4000, 24, 1, 0.1),
)


def simulate(kind: Kind, seed: Sequence[int]) -> dict[str, list[LogValue]]:
    """Return the values of each term for each log of one fleet."""
    rng = np.random.default_rng(seed)
    found: dict[str, list[LogValue]] = {}
    for unit in range(kind.units):
        own = {key: value * math.exp(kind.tau * rng.standard_normal()) for key, value in kind.truth.items()}
        model = imucal.NoiseModel.parse(" + ".join(f"{key}={value}" for key, value in own.items()))
        for _ in range(kind.logs):
            fit = quick_fit(model.simulate(kind.samples, rate_hz=RATE, rng=rng))
            for term, value in log_values(f"u{unit}", fit).items():
                found.setdefault(term, []).append(value)
    return found


def outcome(found: Population, logs: Sequence[LogValue], truth: float, tau: float) -> list[float]:
    """Return the contribution of one fleet to the row of a term."""
    bound = truth * math.exp(float(ndtri(0.95)) * tau)
    detected = bool(truth) and not found.bounded
    spread = found.spread if detected else None
    errors = [(log.variance_sd or math.nan) + log.variance_growth * truth**2 for log in logs]
    return [
        truth**2 / float(np.mean(errors)),
        found.bounded,
        math.log(found.median.value / truth) if detected else math.nan,
        found.median.low <= truth <= found.median.high,
        math.log(found.median.high / found.median.low) / (2 * float(ndtri(0.975)))
        if detected and found.median.low
        else math.nan,
        spread.low <= tau <= spread.high if spread else math.nan,
        (found.tolerance or 0.0) >= bound,
        (found.tolerance or 0.0) / bound if truth else math.nan,
        any(unit.odd for unit in found.units),
    ]


def one_fleet(task: tuple[int, int, int]) -> dict[str, list[float]]:
    """Return the outcome of each term of one fleet, from the index of its kind and the seed."""
    place, seed, number = task
    kind = KINDS[place]
    logs = simulate(kind, [seed, place, number])
    return {
        term: outcome(population(values), values, kind.truth.get(term, 0.0), kind.tau)
        for term, values in logs.items()
    }


def main() -> None:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fleets", type=int, default=100)
    parser.add_argument("--seed", type=int, default=7301)
    parser.add_argument("--kinds", type=int, nargs="*", default=range(len(KINDS)), help="which, from 0")
    parser.add_argument("--jobs", type=int, default=multiprocessing.cpu_count())
    options = parser.parse_args()
    print(
        "| fleet (units × logs of samples, tau) | term | told by | fleets that bound | median: bias, cover "
        "| error | tau cover | 95/95 cover, ÷ true quantile | odd alarms |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    begun = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for place in options.kinds:
            fleets = pool.map(one_fleet, [(place, options.seed, number) for number in range(options.fleets)])
            for term in fleets[0]:
                print_row(KINDS[place], term, np.array([fleet[term] for fleet in fleets], dtype=np.float64))
    print(f"\n{time.perf_counter() - begun:.0f} s")


def print_row(kind: Kind, term: str, table: np.ndarray) -> None:
    """Print a row of the table."""
    detected = table[~np.isnan(table[:, 2])]
    many = len(detected) > 1
    bias = f"{100 * np.mean(detected[:, 2]):+.1f}" if many else "–"
    error = f"{np.std(detected[:, 2], ddof=1) / np.nanmean(detected[:, 4]):.2f}" if many else "–"
    tau = f"{100 * np.nanmean(detected[:, 5]):.0f}" if many else "–"
    share = 100 * table.mean(axis=0)
    far = f", {np.median(table[:, 7]):.2f}" if kind.truth.get(term) else ""
    print(
        f"| {kind.title} | {term} | {np.mean(table[:, 0]):.1f} | {share[1]:.0f} | {bias}, {share[3]:.0f} "
        f"| {error} | {tau} | {share[6]:.0f}{far} | {share[8]:.0f} |",
        flush=True,
    )


if __name__ == "__main__":
    main()

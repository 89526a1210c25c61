"""False alarms of the tests of several logs of one unit, for a complete fleet as in its report.

``python -m tests.benchmarks.fleet_alarms --fleets 100 --seed 8803`` prints a table in Markdown: the share
of fleets with a reported unit, if units differ and logs of one unit do not; and the detection rate of one
log of one unit with 30 % more N. Samples of one axis are simulated and fitted from their bins.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.fitting.spectral.given_model import fit_bins, record_tests
from imucal.multiple_tests import SIGNIFICANCE, holm
from tests.fleet.records import bins_from, simulated

#: Relative spread of N, B and K between units.
SPREADS = {"N": 0.1, "B": 0.2, "K": 0.3}
#: Name of a fleet -> its median unit.
FLEETS = {
    "K weak": {"N": 1e-3, "B": 2e-4, "K": 1e-4},
    "K strong": {"N": 1e-3, "B": 2e-4, "K": 1e-3},
    "B strong": {"N": 1e-3, "B": 1e-3, "K": 1e-4},
}


@dataclass(frozen=True)
class Size:
    """Units of a fleet, logs per unit, samples per log."""

    units: int
    logs: int
    samples: int


def p_values(size: Size, truth: dict[str, float], seed: Sequence[int], *, last: float) -> list[float]:
    """Return the p-values of a unit's terms; the last of its logs has `last` times its N."""
    every = []
    for log in range(size.logs):
        own = truth | {"N": truth["N"] * (last if log == size.logs - 1 else 1.0)}
        text = " + ".join(f"{key}={value}" for key, value in own.items())
        every.append(bins_from(simulated(text, size.samples, *seed, log)))
    return [test.p_value for test in record_tests(fit_bins(every, tuple(truth), level=0.95))]


def named(tests: list[list[float]]) -> set[int]:
    """Return the units that a report with these tests, by unit and term, lists."""
    judged = np.reshape(holm(np.ravel(tests)), (len(tests), -1))
    return set(np.flatnonzero((judged <= SIGNIFICANCE).any(axis=1)).tolist())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--fleets", type=int, default=100)
    parser.add_argument("--units", type=int, default=10)
    parser.add_argument("--logs", type=int, default=3)
    parser.add_argument("--samples", type=int, default=4000)
    parser.add_argument("--more", type=float, default=30.0, help="%% of N, in one log of one unit")
    parser.add_argument("--seed", type=int, default=8803)
    asked = parser.parse_args()
    size = Size(asked.units, asked.logs, asked.samples)
    print(
        f"In % of {asked.fleets} fleets of {size.units} units × {size.logs} logs of {size.samples} samples:\n"
    )
    print(
        f"| fleet | a unit is named falsely | N + {asked.more:g} % in one log of one unit is found "
        "| … and another unit is named falsely |"
    )
    print("|---|---|---|---|")
    for number, (name, median) in enumerate(FLEETS.items()):
        falsely, found, others = 0, 0, 0
        for fleet in range(asked.fleets):
            rng = np.random.default_rng((asked.seed, number, fleet))
            truths = [
                {key: value * np.exp(SPREADS[key] * rng.standard_normal()) for key, value in median.items()}
                for _ in range(size.units)
            ]
            seed = (asked.seed, number, fleet)
            alike = [p_values(size, truth, (*seed, unit), last=1.0) for unit, truth in enumerate(truths)]
            changed = p_values(size, truths[0], (*seed, size.units), last=1 + asked.more / 100)
            falsely += bool(named(alike))
            seen = named([changed, *alike[1:]])
            found += 0 in seen
            others += bool(seen - {0})
        shares = (f"{100 * count / asked.fleets:.0f}" for count in (falsely, found, others))
        print(f"| {name} | {' | '.join(shares)} |", flush=True)


if __name__ == "__main__":
    main()

"""Planned record lengths compared with the default fit: width of intervals, detection rate.

    python tests/benchmarks/planned.py --records 24 --seed 77 [--truth B …] [--bound 0.15 …]

Each row is a truth at 20 Hz, with a length at which the Cramér-Rao bound of one term's relative standard
error is the given one. The median half-width is in standard errors of the truth; a bounded term counts as
infinitely wide.
"""

import argparse
import math

import numpy as np

import imucal
from imucal.fitting.spectral import relative_deviations
from imucal.noise.model import NoiseModel
from imucal.planning import plan

RATE_HZ = 20.0
TRUTHS = {
    "K beside B": ("N=1e-4 + B=3e-5 + K=3e-6", "K"),
    "B beside K": ("N=1e-4 + B=3e-5 + K=1e-6", "B"),
    "K": ("N=1e-4 + K=3e-6", "K"),
    "B": ("N=1e-4 + B=3e-5", "B"),
    "R": ("N=1e-4 + R=4e-7", "R"),
    "K beside R": ("N=1e-4 + K=3e-6 + R=1e-8", "K"),
}


def needed(model: NoiseModel, name: str, bound: float) -> float:
    """Return the record length at which the bound on the relative standard error has the given value."""
    low, high = math.log(5.0), math.log(1e7)
    while high - low > 1e-3:
        middle = (low + high) / 2
        errors = relative_deviations(model, rate_hz=RATE_HZ, duration_s=math.exp(middle))
        low, high = (middle, high) if errors[name] > bound else (low, middle)
    return math.exp(high)


def half_widths(model: NoiseModel, name: str, duration_s: float, records: int, seed: int) -> np.ndarray:
    """Return the relative half-width of each record's interval, in standard errors; inf for a bound."""
    truth = next(term.coefficient for term in model.terms if term.symbol == name)
    widths = []
    for record in range(records):
        rng = np.random.default_rng([seed, record, round(duration_s)])
        samples = model.simulate(round(duration_s * RATE_HZ), rate_hz=RATE_HZ, rng=rng)
        fit = imucal.fit(imucal.AxisSeries.from_samples(samples, rate_hz=RATE_HZ))
        found = next((e for e in fit.estimates if e.key == name and e.value is not None), None)
        widths.append((found.high - found.low) / 2 / 1.96 / truth if found else math.inf)
    return np.array(widths)


def main() -> None:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=24)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--truth", nargs="*", default=list(TRUTHS), choices=list(TRUTHS))
    parser.add_argument("--bound", nargs="*", type=float, default=[0.1, 0.15, 0.2, 0.25, 0.3])
    options = parser.parse_args()
    print("| term | bound | length, s | planned | found, median | planned shown | found shown |")
    print("|---|---|---|---|---|---|---|")
    for label in options.truth:
        text, name = TRUTHS[label]
        model = NoiseModel.parse(text)
        for bound in options.bound:
            duration = needed(model, name, bound)
            (axis,) = plan(model, rate_hz=RATE_HZ, duration_s=duration).axes
            need = next(need for need in axis.needs if need.name == name)
            found = half_widths(model, name, duration, options.records, options.seed)
            print(
                f"| {label} | {bound} | {duration:.0f} | {need.reached:.3f} | {np.median(found):.3f} "
                f"| {need.detected:.2f} | {np.isfinite(found).mean():.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

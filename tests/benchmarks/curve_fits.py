"""Accuracy of fits of the Allan curve: relative RMSE, bias and coverage of 95 % intervals.

    python -m tests.benchmarks.curve_fits --samples 100000 --records 300 --weights full

Settings A-F are those of the documentation (per-sample units). Errors are compared with the
Cramér-Rao bound of `imucal.fitting.spectral.precision`. The seed 77 was never used for tuning. A record
takes about 0.3 s of CPU, mostly for the covariance of the curve.
"""

import argparse
import time

import numpy as np

from imucal.fitting import FitSettings
from imucal.fitting.moments import fit_gmwm
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.spectral import relative_deviations
from imucal.noise.model import NoiseModel
from tests.fitting.moments.curves import simulated_curve

SETTINGS = {
    "A": "N=1 + K=1e-3",
    "B": "N=1 + GM(sigma=0.1, T=500)",
    "C": "Q=1.7320508 + N=1 + K=1e-3",
    "D": "N=1 + B=0.0632456 + K=5.477e-4",
    "E": "N=1 + GM(sigma=0.2236, T=50) + GM(sigma=0.1, T=3000) + K=3.162e-4",
    "F": "N=1 + R=1e-6",
}


def main() -> None:
    """Print one line per parameter."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--settings", default="ABCDEF")
    parser.add_argument("--weights", default="full", choices=("full", "eta3"))
    options = parser.parse_args()
    for setting in options.settings:
        run(setting, options.samples, options.records, options.weights)


def run(setting: str, n: int, records: int, weights: str) -> None:
    """Fit `records` records of a setting and print the results."""
    truth = NoiseModel.parse(SETTINGS[setting])
    bound = relative_deviations(truth, rate_hz=1.0, duration_s=float(n))
    rng = np.random.default_rng(77)
    begin = time.process_time()
    fits = [
        fit_gmwm(
            None, simulated_curve(SETTINGS[setting], n, rng), FitSettings(model=str(truth), weights=weights)
        )
        for _ in range(records)
    ]
    seconds = (time.process_time() - begin) / records
    print(f"{setting} n={n} {weights}: {seconds:.2f} s CPU a record, {records} records")
    true_values = values(truth)
    for name, value in true_values.items():
        errors = np.array([values(fit.model)[name] / value - 1 for fit in fits])
        covered = np.mean([inside(fit, name, value) for fit in fits])
        rmse = float(np.sqrt(np.mean(errors**2)))
        print(
            f"  {name:10} bound {100 * bound[name]:6.2f} %  RMSE/bound {rmse / bound[name]:5.2f}  "
            f"bias {100 * errors.mean():6.2f} %  coverage {100 * covered:5.1f} %"
        )


def values(model: NoiseModel) -> dict[str, float]:
    """Return the parameters by name, Gauss-Markov terms by increasing correlation time."""
    terms = sorted((t.T, t.sigma) for t in model.terms if hasattr(t, "T") and hasattr(t, "sigma"))
    found = {t.symbol: t.coefficient for t in model.terms if t.symbol != "GM"}
    for place, (long, sigma) in enumerate(terms, start=1):
        key = "GM" if len(terms) == 1 else f"GM{place}"
        found |= {f"{key}.sigma": sigma, f"{key}.T": long}
    return found


def inside(fit: NoiseFit, name: str, value: float) -> bool:
    """Return whether an interval covers the truth."""
    key, _, part = name.partition(".")
    estimate = fit[key]
    if part == "T":
        time_ = estimate.correlation_time
        return time_ is None or time_.low <= value <= time_.high
    return estimate.low <= value <= estimate.high


if __name__ == "__main__":
    main()

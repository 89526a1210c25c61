"""Coverage of a given model's intervals if samples are lost at random.

    python -m tests.benchmarks.lost_samples [--records 200] [--seed 911] [--share 0.3] [--terms 2]

For each share of lost samples and each model, the table lists the percentage of records of 120 000 samples
whose 95 % interval contains the truth, the mean of chi2_per_bin, and the records with a finding of a misfit
or of an output filter.
"""

import argparse
from collections import Counter

import numpy as np

from imucal.fitting import FitSettings
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.spectral import fit_mle
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries
from tests.fitting.fits import no_curve

RATE_HZ, SAMPLES = 100.0, 120_000
SHARES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.6)
#: In units per second: with white noise of one per sample at this rate.
TRUTHS = ("N=0.1 + K=0.05", "N=0.1 + B=0.3 + K=0.05")
#: Findings that would be false.
CODES = ("model-misfit", "output-filter")


def fit_with_losses(truth: str, share: float, seed: tuple[int, ...]) -> NoiseFit:
    """Return the fit of a record with a share of its samples lost at random."""
    rng = np.random.default_rng(seed)
    model = NoiseModel.parse(truth)
    samples = model.simulate(SAMPLES, rate_hz=RATE_HZ, rng=rng)
    samples[1:-1][rng.random(SAMPLES - 2) < share] = np.nan
    series = AxisSeries.from_samples(samples, rate_hz=RATE_HZ).finite()
    structure = " + ".join(part.partition("=")[0] for part in truth.split(" + "))
    return fit_mle(series, no_curve(series.n), FitSettings(model=structure, level=0.95), None)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--seed", type=int, default=911)
    parser.add_argument("--share", type=float, action="append")
    parser.add_argument("--terms", type=int, help="only the model with this number of terms")
    asked = parser.parse_args()
    print("| model | lost | intervals that contain the truth | chi2 per bin | false findings |")
    print("|---|---|---|---|---|")
    for truth in (text for text in TRUTHS if asked.terms in {None, text.count("=")}):
        values = {part.partition("=")[0]: float(part.partition("=")[2]) for part in truth.split(" + ")}
        for share in asked.share or SHARES:
            hits: Counter[str] = Counter()
            chi2 = 0.0
            for record in range(asked.records):
                fit = fit_with_losses(truth, share, (asked.seed, record, round(100 * share)))
                hits.update(
                    name for name, value in values.items() if fit[name].low <= value <= fit[name].high
                )
                hits.update({finding.code for finding in fit.findings} & set(CODES))
                chi2 += fit.goodness.chi2_per_bin / asked.records
            covered = ", ".join(f"{name} {100 * hits[name] / asked.records:.1f} %" for name in values)
            false = ", ".join(f"{code} {hits[code]}" for code in CODES if hits[code])
            print(f"| {truth} | {share:.0%} | {covered} | {chi2:.2f} | {false} |", flush=True)


if __name__ == "__main__":
    main()

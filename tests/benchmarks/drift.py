"""Accuracy of predicted drifts: simulated coasts compared with the command, and coverage of limits.

    python -m tests.benchmarks.drift [--coasts 8000] [--records 48] [--seed 911] [--only coasts|limits]

The first table has the rms of simulated coasts after a rest of 60 s, relative to the values of `imucal drift`
for the true model. The second table has the percentage of records with default fits whose limits cover the
true drift; in brackets the percentages whose limits are both below it, and above it.
"""

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

import imucal
from imucal.arrays import FloatArray
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS
from imucal.recording import Sensor
from imucal.units import G0
from tests.cli.reports import write_report
from tests.cli.run import run
from tests.report.synthetic import axis_report, small_report

RATE_HZ, REST_S, TIMES_S = 10.0, 60.0, (1.0, 10.0, 60.0, 300.0)
TRUTHS = {
    "N": "N=1e-3",
    "N + B": "N=1e-3 + B=3e-4",
    "N + K": "N=1e-3 + K=2e-5",
    "N + B + K": "N=1e-3 + B=3e-4 + K=2e-5",
    "N + GM": "N=1e-3 + GM(sigma=3e-4, T=50)",
    "N + B + GM": "N=1e-3 + B=2e-4 + GM(sigma=4e-4, T=200)",
}
LENGTHS_S = {"20 min": 1200.0, "2 h": 7200.0}
#: Coasts of one simulated record.
PARTS = 50
#: The command's names of the first, second and third integral of a gyroscope.
QUANTITIES = ("angle", "velocity through tilt", "position through tilt")


def drawn_rms(
    model: NoiseModel, times_s: Sequence[float], *, coasts: int, rng: np.random.Generator
) -> dict[str, FloatArray]:
    """Return the rms of integrated errors by quantity, shape (t,): samples minus their rest's mean.

    A sample is a rate that is constant until the next one, so its first integral is piecewise linear.
    """
    rest, coast = round(REST_S * RATE_HZ), round(max(times_s) * RATE_HZ)
    at = [round(time * RATE_HZ) for time in times_s]
    squares: dict[str, list[FloatArray]] = {name: [] for name in QUANTITIES}
    for _ in range(coasts // PARTS):
        # Parts of one long record, whose bias has varied long before most of them.
        parts = model.simulate(PARTS * (rest + coast), rate_hz=RATE_HZ, rng=rng).reshape(PARTS, -1)
        rate = parts[:, rest:] - parts[:, :rest].mean(axis=1, keepdims=True)
        angle = np.pad(np.cumsum(rate, axis=1), ((0, 0), (1, 0))) / RATE_HZ
        velocity = G0 * cumulative_trapezoid(angle, dx=1 / RATE_HZ, axis=1, initial=0)
        position = cumulative_trapezoid(velocity, dx=1 / RATE_HZ, axis=1, initial=0)
        for name, error in zip(QUANTITIES, (angle, velocity, position), strict=True):
            squares[name].append(np.mean(np.square(error[:, at]), axis=0))
    return {name: np.sqrt(np.mean(own, axis=0)) for name, own in squares.items()}


def printed(text: str, times_s: Sequence[float]) -> dict[str, FloatArray]:
    """Return the command's output for a gyroscope with this model, by quantity, shape (t,)."""
    absent = {symbol: 1e-12 for symbol in ALWAYS if f"{symbol}=" not in text}
    axis = axis_report(Sensor.GYROSCOPE, "x", text, bounds=absent, rate_hz=RATE_HZ, n=100_000)
    asked = ",".join(f"{time:g}" for time in times_s)
    with tempfile.TemporaryDirectory() as place:
        name = write_report(Path(place), report=replace(small_report(), axes=(axis,)))
        done = run("drift", name, "--rest", f"{REST_S:g}", "--times", asked, "--json", "-q", cwd=Path(place))
    found = json.loads(done.stdout)["quantities"]
    return {one["name"]: np.array([point["value"] for point in one["points"]]) for one in found}


def limits(
    text: str, length_s: float, seed: Sequence[int]
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return the limits of the drift of a record's default fit, by quantity, shape (t,) each."""
    rng = np.random.default_rng(seed)
    samples = NoiseModel.parse(text).simulate(round(length_s * RATE_HZ), rate_hz=RATE_HZ, rng=rng)
    series = imucal.AxisSeries.from_samples(samples, rate_hz=RATE_HZ, sensor="gyroscope", axis="x")
    found = imucal.drift(imucal.fit(series), TIMES_S, rest_s=REST_S)
    low, high = (
        {one.name: np.array([getattr(p, end) for p in one.points]) for one in found.quantities}
        for end in ("low", "high")
    )
    return low, high


def main() -> None:
    """Print both tables in Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--coasts", type=int, default=8000)
    parser.add_argument("--records", type=int, default=48)
    parser.add_argument("--seed", type=int, default=911)
    parser.add_argument("--only", choices=["coasts", "limits"])
    options = parser.parse_args()
    heads = " | ".join(f"{time:g} s" for time in TIMES_S)
    truths = {label: printed(text, TIMES_S) for label, text in TRUTHS.items()}
    if options.only != "limits":
        print(f"| truth | quantity | {heads} |\n|---|---|{'---|' * len(TIMES_S)}")
        for row, (label, text) in enumerate(TRUTHS.items()):
            rng = np.random.default_rng([options.seed, row])
            drawn = drawn_rms(NoiseModel.parse(text), TIMES_S, coasts=options.coasts, rng=rng)
            for name in QUANTITIES:
                ratios = " | ".join(f"{ratio:.3f}" for ratio in drawn[name] / truths[label][name])
                print(f"| {label} | {name} | {ratios} |", flush=True)
    if options.only != "coasts":
        print(f"\n| truth | length | quantity | {heads} |\n|---|---|---|{'---|' * len(TIMES_S)}")
        for row, (label, text) in enumerate(TRUTHS.items()):
            for length, seconds in LENGTHS_S.items():
                seeds = ([options.seed, row, round(seconds), record] for record in range(options.records))
                found = [limits(text, seconds, seed) for seed in seeds]
                for name in QUANTITIES:
                    truth = truths[label][name]
                    below = np.mean([high[name] < truth for _, high in found], axis=0)
                    above = np.mean([low[name] > truth for low, _ in found], axis=0)
                    cells = " | ".join(
                        f"{100 * (1 - b - a):.0f} ({100 * b:.0f}, {100 * a:.0f})"
                        for b, a in zip(below, above, strict=True)
                    )
                    print(f"| {label} | {length} | {name} | {cells} |", flush=True)


if __name__ == "__main__":
    main()

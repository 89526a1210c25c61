"""Labs of 40 units with the real commands: ``python -m tests.benchmarks.fleet_labs [--seed 9301]``.

Simulated logs at two temperatures per unit are fitted by ``imucal fleet run``, and ``fleet.json`` is
compared with the truth: only the odd unit is reported, each median is covered, and each 95/95 bound is
above 95 % of all units.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from imucal.noise import NoiseModel
from imucal.units import G0

#: Median N, B, K of a sensor, in SI; relative spread between units.
MEDIANS = {"gyroscope": (1e-4, 1e-4, 1e-4), "accelerometer": (1e-3, 1e-3, 1e-3)}
TAU = 0.15
#: Factor on N of one axis of the odd unit: 6.1 deviations. A test of 720 values with a limited false
#: discovery rate finds it in 99 of 100 labs; a factor of 2 (4.6 deviations) in 60.
ODD_FACTOR = 2.5
RATE = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Results of one lab's report: counts and totals."""

    named: bool
    false_names: int
    medians: int
    bounds: int
    terms: int
    bounded: int


def make_lab(folder: Path, *, units: int, seconds: float, seed: int) -> str:
    """Write the logs of a lab; return the name of its odd unit."""
    rng = np.random.default_rng(seed)
    odd = int(rng.integers(units))
    for unit in range(units):
        own = {sensor: np.exp(TAU * rng.standard_normal((3, 3))) * m for sensor, m in MEDIANS.items()}
        if unit == odd:
            own["gyroscope"][0, 0] = ODD_FACTOR * MEDIANS["gyroscope"][0]
        for celsius in (15, 45):
            columns = {name: _samples(own[name], round(seconds * RATE), rng) for name in MEDIANS}
            columns["accelerometer"][:, 2] += G0
            path = folder / f"SN{unit:02}" / f"{celsius}C.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            stamps = np.arange(len(columns["gyroscope"])) / RATE
            gyro, accel = columns["gyroscope"], columns["accelerometer"]
            np.savez(path, **{"time (s)": stamps, "gyro (rad/s)": gyro, "accel (m/s^2)": accel})
    return f"SN{odd:02}"


def _samples(coefficients: Any, n: int, rng: np.random.Generator) -> Any:  # noqa: ANN401 - arrays
    """Return the samples of three axes, (n, 3), from their N, B and K, (axes, terms)."""
    models = [NoiseModel.parse(f"N={n_!r} + B={b!r} + K={k!r}") for n_, b, k in coefficients.tolist()]
    return np.column_stack([model.simulate(n, rate_hz=RATE, rng=rng) for model in models])


def judged(document: dict[str, Any], odd: str) -> Found:
    """Return the comparison of a lab's ``fleet.json`` with the truth."""
    (model,) = document["models"]
    named = {unit["unit"] for term in model["terms"] for unit in term["units"] if unit["odd_overall"]}
    medians = bounds = 0
    for term in model["terms"]:
        truth = MEDIANS[term["sensor"]]["NBK".index(term["term"])]
        medians += term["median"]["low"] <= truth <= term["median"]["high"]
        bounds += term["tolerance"] >= truth * math.exp(float(ndtri(0.95)) * TAU)
    return Found(
        named=odd in named,
        false_names=len(named - {odd}),
        medians=medians,
        bounds=bounds,
        terms=len(model["terms"]),
        bounded=sum(term["bounded"] for term in model["terms"]),
    )


def main() -> None:
    """Print a row per lab, and totals."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--labs", type=int, default=3)
    parser.add_argument("--units", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=9301)
    parser.add_argument("--jobs", default="1")
    asked = parser.parse_args()
    print("| lab | odd unit | named | others named | medians held | 95/95 bounds held | only bounded |")
    print("|---|---|---|---|---|---|---|")
    every = []
    for lab in range(asked.labs):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            odd = make_lab(folder / "logs", units=asked.units, seconds=asked.seconds, seed=asked.seed + lab)
            command = [sys.executable, "-m", "imucal", "fleet", "run", "logs", "--jobs", asked.jobs]
            command += ["--labels", "{unit}/{temperature_c}C.npz"]
            subprocess.run(command, cwd=folder, check=True, capture_output=True)  # noqa: S603
            found = judged(json.loads((folder / "fleet" / "fleet.json").read_text(encoding="utf-8")), odd)
        every.append(found)
        print(
            f"| {lab} | {odd} | {'yes' if found.named else 'no'} | {found.false_names} | {found.medians} of "
            f"{found.terms} | {found.bounds} of {found.terms} | {found.bounded} |",
            flush=True,
        )
    terms = sum(one.terms for one in every)
    medians, bounds = (
        100 * sum(getattr(one, name) for one in every) / terms for name in ("medians", "bounds")
    )
    shares = f"medians {medians:.0f} %, bounds {bounds:.0f} %"
    print(f"\nnamed {sum(one.named for one in every)} of {len(every)}; {shares}")


if __name__ == "__main__":
    main()

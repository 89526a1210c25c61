"""False alarms on configs of another record of the same sensor, and detection of common mistakes.

``python -m tests.benchmarks.config_slips --seed 81 --pairs 6`` simulates pairs of records of one gyroscope,
exports a Kalibr file of the first, and checks it, unchanged and with each mistake, against the second.
"""

import argparse
import math
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import imucal
from imucal.checking import check_config
from imucal.checking.verdict import Row
from imucal.pipeline import characterize
from imucal.recording import Sensor
from imucal.report.exports import render
from imucal.report.result import Report
from imucal.simulation import SensorTruth, simulate_recording

RATE_HZ = 100.0
TRUTHS = (
    "N=1e-4 + K=1e-6",
    "N=1e-4 + B=2e-5",
    "N=1e-4 + B=2e-5 + K=3e-7",
    "N=1e-4 + GM(sigma=3e-5, T=60)",
)
MINUTES = (10, 60)
#: Mistake -> change of the number, and part of the expected text.
SLIPS: dict[str, tuple[Callable[[float], float], str]] = {
    "sqrt(f)": (lambda c: c * math.sqrt(RATE_HZ), "large: by sqrt(f)"),
    "1/sqrt(f)": (lambda c: c / math.sqrt(RATE_HZ), "small: by sqrt(f)"),
    "f": (lambda c: c * RATE_HZ, "large: by f ="),
    "degrees": (lambda c: c / math.radians(1), "large: by 57.3"),
    "square": (lambda c: c * c, "the square of"),
    "tiny": (lambda _: 6.5e-15, "absurd"),
}


def report_of(truth: str, minutes: float, seed: int) -> Report:
    """Return the report of a simulated gyroscope at rest."""
    sensor = SensorTruth(model=imucal.NoiseModel.parse(truth), mean=(0.0, 0.0, 0.0))
    recording = simulate_recording(
        gyroscope=sensor, accelerometer=sensor, rate_hz=RATE_HZ, duration_s=60 * minutes, seed=seed
    )
    gyroscope = tuple(series for series in recording.series if series.sensor is Sensor.GYROSCOPE)
    return characterize(replace(recording, series=gyroscope))


def rows_of(text: str, report: Report, file: Path) -> dict[str, Row]:
    """Return the verdicts on a config's white noise and random walk."""
    file.write_text(text, encoding="utf-8")
    return {row.subject: row for row in check_config(file, report) if row.where != "log"}


def main() -> None:
    """Print verdicts on correct configs, and how often each mistake was identified and failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=81)
    parser.add_argument("--pairs", type=int, default=6)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "imu.yaml"
        for minutes in MINUTES:
            for truth in TRUTHS:
                right, named, failed = Counter[str](), Counter[str](), Counter[str]()
                for i in range(asked.pairs):
                    one, other = (report_of(truth, minutes, 1000 * asked.seed + 2 * i + k) for k in (0, 1))
                    rows = rows_of(render(one, "kalibr"), other, file)
                    right.update(f"{key.partition('_')[2]} {row.verdict}" for key, row in rows.items())
                    values = {key: row.measured.value or 0.0 for key, row in rows.items() if row.measured}
                    for slip, (make, expected) in SLIPS.items():
                        for key, number in values.items():
                            wrong = {**values, key: make(number)}
                            text = "".join(f"{name}: {value!r}\n" for name, value in wrong.items())
                            row = rows_of(text, other, file)[key]
                            cell = f"{slip} {key.partition('_')[2]}"
                            named[cell] += expected in row.text
                            failed[cell] += row.verdict == "fail"
                print(f"{minutes} min, {truth}: {dict(right)}")
                print("  named, failed:", {cell: (named[cell], failed[cell]) for cell in failed}, flush=True)


if __name__ == "__main__":
    main()

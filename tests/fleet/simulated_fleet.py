"""Logs of a fleet with known truth, some of them broken: ``python -m tests.fleet.simulated_fleet FOLDER``.

There are three sensor models with ten units each; some units have several logs at different temperatures.
A unit's coefficients have a spread of 20 % about its model's. The last unit of the first model has three
times the noise. Broken logs are empty, truncated, garbage, moved by hand, copies or too short.
"""

import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imucal.arrays import FloatArray
from imucal.noise import NoiseModel
from imucal.units import G0

#: Model -> median N, B, K of the gyroscope and of the accelerometer, in SI.
TRUTH = {
    "alpha": ((1e-4, 2e-5, 2e-6), (1e-3, 2e-4, 2e-5)),
    "beta": ((3e-4, 6e-5, 5e-6), (2e-3, 3e-4, 4e-5)),
    "gamma": ((1e-3, 1e-4, 2e-5), (4e-3, 1e-3, 1e-4)),
}
#: Spread of a coefficient between units: standard deviation of its logarithm.
TAU = 0.2
#: The odd unit and its factor.
ODD, ODD_FACTOR = ("alpha", "u09"), 3.0
RATE = 100.0
UNITS = 10


@dataclass(frozen=True, kw_only=True)
class MadeLog:
    """A log and its fault; `broken` is empty for a log without a fault."""

    path: Path
    model: str
    unit: str
    temperature_c: float
    broken: str = ""


def make_fleet(
    folder: Path, *, logs: int = 200, seconds: float = 600.0, seed: int = 1, axes: int = 3
) -> list[MadeLog]:
    """Write a fleet as ``folder/model/unit/25C/log.npz``; every 20th log from the eighth on is broken.

    A log has three axes of both sensors, or one axis of the gyroscope, which takes a sixth of the time.
    """
    rng = np.random.default_rng(seed)
    made: list[MadeLog] = []
    factors = {
        (model, f"u{unit:02}"): np.exp(TAU * rng.normal(size=3)) for model in TRUTH for unit in range(UNITS)
    }
    factors[ODD] = np.full(3, ODD_FACTOR)
    for number in range(logs):
        model = list(TRUTH)[number % len(TRUTH)]
        unit = f"u{number // len(TRUTH) % UNITS:02}"
        temperature = (15.0, 25.0, 45.0)[number // (len(TRUTH) * UNITS) % 3]
        home = folder / model / unit / f"{temperature:g}C"
        home.mkdir(parents=True, exist_ok=True)
        path = home / f"log{number:04}.npz"
        truth = TRUTH[model] if axes == 3 else TRUTH[model][:1]
        day = number // (len(TRUTH) * UNITS)
        samples = _samples(truth, factors[model, unit], round(seconds * RATE), rng, axes)
        start = 1_767_225_600 + 86400 * day
        broken = _BROKEN[number // 20 % len(_BROKEN)] if number % 20 == 7 else ""
        _write(path, samples, start, broken, [log.path for log in made if not log.broken])
        made.append(MadeLog(path=path, model=model, unit=unit, temperature_c=temperature, broken=broken))
    return made


_BROKEN = ("cut", "moved", "empty", "copy", "garbage", "short")


def _samples(
    truth: tuple[tuple[float, float, float], ...],
    factors: FloatArray,
    n: int,
    rng: np.random.Generator,
    axes: int,
) -> FloatArray:
    rows = []
    for sensor, coefficients in enumerate(truth):
        n_, b, k = (float(c * f) for c, f in zip(coefficients, factors, strict=True))
        model = NoiseModel.parse(f"N={n_!r} + B={b!r} + K={k!r}")
        for axis in range(axes):
            mean = G0 if sensor == 1 and axis == 2 else 0.0
            rows.append(mean + model.simulate(n, rate_hz=RATE, rng=rng))
    return np.stack(rows)


def _write(path: Path, samples: FloatArray, start: int, broken: str, others: list[Path]) -> None:
    if broken == "copy" and others:
        shutil.copy(others[0], path)
        return
    if broken == "moved":
        samples = samples.copy()
        third = samples.shape[1] // 3
        samples[:3, third : third + 500] += np.sin(np.arange(500) / 30)
        samples[3:, third : third + 500] += 3 * np.sin(np.arange(500) / 25)
    n = 20 if broken == "short" else samples.shape[1]
    stamps = start + np.arange(n) / RATE
    if len(samples) == 1:
        columns = {"time (s)": stamps, "gx (rad/s)": samples[0, :n]}
    else:
        columns = {"time (s)": stamps, "gyro (rad/s)": samples[:3, :n].T, "accel (m/s^2)": samples[3:, :n].T}
    np.savez(path, **columns)  # type: ignore[arg-type] # its last argument is a flag
    if broken == "cut":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    elif broken == "garbage":
        path.write_bytes(np.random.default_rng(start).bytes(5000))
    elif broken == "empty":
        path.write_bytes(b"")


def main() -> None:
    """Write a fleet to the folder in the arguments."""
    made = make_fleet(Path(sys.argv[1]), logs=int(sys.argv[2]) if len(sys.argv) > 2 else 200)
    sys.stdout.write(f"{len(made)} logs, {sum(bool(log.broken) for log in made)} of them broken\n")


if __name__ == "__main__":
    main()

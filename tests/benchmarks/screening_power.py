"""Detection rate of faults by the screening, by fault and size in deviations of the noise.

Run as ``python -m tests.benchmarks.screening_power [LOGS]``. Logs have 200 s at 100 Hz of white noise.
"""

import sys

import numpy as np

from imucal.arrays import FloatArray
from imucal.pipeline import screen
from imucal.recording import Sensor
from tests.screening.still import NOISE, recording, still

N, RATE = 20_000, 100.0
T = np.arange(N) / RATE

#: Fault -> code, and the shape added to one axis for a size of 1.
FAULTS: dict[str, tuple[str, FloatArray]] = {
    "knock, 0.2 s of 20 Hz": ("touch", np.where((T >= 90) & (T < 90.2), np.sin(2 * np.pi * 20 * T), 0)),
    "knock, 1 s of 5 Hz": ("touch", np.where((T >= 90) & (T < 91), np.sin(2 * np.pi * 5 * T), 0)),
    "step that stays": ("step", np.where(T > 120, 1.0, 0.0)),
    "warm-up, 20 s": ("warm-up", np.exp(-T / 20)),
    "tone, 31 Hz": ("tone", np.sin(2 * np.pi * 31 * T)),
    "tone, 3 Hz": ("tone", np.sin(2 * np.pi * 3 * T)),
}
SIZES = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0)


def share(code: str, shape: FloatArray, size: float, logs: int) -> float:
    """Return the share of logs in which a fault of the accelerometer's x axis is found."""
    found = 0
    for seed in range(20_000, 20_000 + logs):
        gyro, accel = still(N, seed)
        accel[0] += size * NOISE[Sensor.ACCELEROMETER] * shape
        found += code in {finding.code for finding in screen(recording(gyro, accel))}
    return found / logs


def main() -> None:
    """Print a row per fault, with a column per size."""
    logs = int(sys.argv[1]) if len(sys.argv) > 1 else 40

    print(f"{'size, in deviations':26s}", *(f"{size:5g}" for size in SIZES))
    for name, (code, shape) in FAULTS.items():
        print(f"{name:26s}", *(f"{share(code, shape, size, logs):5.0%}" for size in SIZES))


if __name__ == "__main__":
    main()

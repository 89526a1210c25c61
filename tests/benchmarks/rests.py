"""Several rests of a drive as one record: coverage and precision of the intervals.

Drives are simulated: rests of different lengths with motion like a car's between them, with slow ramps to
and from rest and springs that ring after it. Each rest has its own pose and bias, the noise continues, and
in some rests the engine idles. The fit of all rests is compared with that of the longest.

    python tests/benchmarks/rests.py [DRIVES] [FIRST SEED] [KIND...]
"""

import sys
from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

import imucal
from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.noise import NoiseModel
from imucal.recording import AXES, AxisSeries, Recording, Source

#: Sampling rate, in Hz.
RATE = 100.0
#: A consumer gyroscope and accelerometer.
TRUTH = {
    "gyroscope": NoiseModel.parse("N=1e-4 + B=6e-5 + K=4e-6"),
    "accelerometer": NoiseModel.parse("N=1e-3 + B=4e-4 + K=3e-5"),
}


@dataclass(frozen=True)
class Drive:
    """A kind of drive: number of rests, ranges of rest and motion in s, and share of shaken rests."""

    rests: int
    rest_s: tuple[float, float]
    motion_s: tuple[float, float]
    shaken: float = 0.0


#: Kinds of drives by name.
DRIVES = {
    "six rests": Drive(6, (120.0, 600.0), (20.0, 120.0)),
    "six equal rests": Drive(6, (300.0, 301.0), (20.0, 120.0)),
    "engine idles in some": Drive(8, (120.0, 600.0), (20.0, 120.0), shaken=0.4),
    "stop and go": Drive(60, (25.0, 60.0), (10.0, 60.0)),
    "two hundred": Drive(200, (15.0, 40.0), (10.0, 30.0)),
    "one rest": Drive(1, (900.0, 901.0), (60.0, 120.0)),
}


def motion(seconds: float, rng: np.random.Generator) -> FloatArray:
    """Return the motion added to the six axes, shape (6, k): turns, throttle, road; smooth at its ends."""
    k = int(seconds * RATE)
    t = np.arange(k) / RATE
    # It starts and stops smoothly within 1.5 s.
    ramp = np.clip(np.minimum(t, t[-1] - t) / 1.5, 0, 1)
    ramp = ramp**2 * (3 - 2 * ramp)
    added = np.empty((6, k))
    for row in range(6):
        size = 0.2 if row < 3 else 1.5
        slow = sum(
            rng.normal() * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.3)) for f in rng.uniform(0.02, 0.5, 4)
        )
        road = rng.normal(size=k) * (0.02 if row < 3 else 0.5)
        added[row] = size * ramp * slow + ramp * road
    return added


def simulate(drive: Drive, seed: int) -> Recording:
    """Return a drive that begins and ends in motion."""
    rng = np.random.default_rng([2026, seed])
    parts: list[FloatArray] = []
    bias = np.zeros(6)
    for number in range(drive.rests + 1):
        move = motion(rng.uniform(*drive.motion_s), rng)
        k = int(rng.uniform(*drive.rest_s) * RATE) if number < drive.rests else 0
        t = np.arange(k) / RATE
        rest = np.zeros((6, k))
        # The springs ring at 1.5 Hz for some seconds.
        ring = np.exp(-t / 0.8) * np.sin(2 * np.pi * 1.5 * t)
        rest[:3] += 0.01 * ring
        rest[3:] += 0.3 * ring
        if rng.random() < drive.shaken:
            for row in range(6):
                idle = np.sin(2 * np.pi * rng.uniform(24, 26) * t) + 0.3 * rng.normal(size=k)
                rest[row] += idle * (0.004 if row < 3 else 0.05)
        pose = rng.normal(size=3) * [0.5, 0.5, 0.02] + [0, 0, 9.81]
        new = np.r_[rng.normal(size=3) * 1e-3, pose]
        # The level changes from one rest's to the next during the motion.
        share = np.clip(np.arange(move.shape[1]) / move.shape[1] * 1.2 - 0.1, 0, 1)
        parts += [move + bias[:, None] + (new - bias)[:, None] * share, rest + new[:, None]]
        bias = new
    values = np.concatenate(parts, axis=1)
    series = []
    for row in range(6):
        sensor = "gyroscope" if row < 3 else "accelerometer"
        noise = TRUTH[sensor].simulate(values.shape[1], rate_hz=RATE, rng=rng)
        samples = values[row] + noise
        series.append(AxisSeries.from_samples(samples, rate_hz=RATE, sensor=sensor, axis=AXES[row % 3]))
    clock = series[0].clock
    return Recording(
        source=Source(path="drive", format="made"), series=tuple(replace(one, clock=clock) for one in series)
    )


def main() -> None:
    """Print coverage, and the ratio of the intervals' widths to those of the longest rest."""
    drives = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    for name, drive in DRIVES.items():
        if len(sys.argv) > 3 and name not in sys.argv[3:]:
            continue
        held, found, gain = (defaultdict(list) for _ in range(3))
        refused = 0
        for seed in range(first, first + drives):
            recording = simulate(drive, seed)
            try:
                rests = imucal.at_rest(recording)
            except DataError:
                refused += 1
                continue
            for series in rests.series:
                longest = max(series.clock.segments, key=lambda s: s.size)
                alone = AxisSeries.from_samples(
                    series.samples[longest.start : longest.stop], rate_hz=RATE, sensor=str(series.sensor)
                )
                all_fit, one_fit = imucal.fit(series), imucal.fit(alone)
                for key in "NBK":
                    truth = next(t.coefficient for t in TRUTH[series.sensor].terms if t.symbol == key)
                    for who, fit in (("all", all_fit), ("longest", one_fit)):
                        held[who, key].append(fit[key].low <= truth <= fit[key].high)
                        found[who, key].append(fit[key].value is not None)
                    gain[key].append(
                        (one_fit[key].high - one_fit[key].low) / (all_fit[key].high - all_fit[key].low)
                    )
        print(f"## {name}: {drives} drives, {refused} refused")
        for key in "NBK":
            for who in ("longest", "all"):
                print(
                    f"{key} {who:8s} holds the truth {100 * np.mean(held[who, key]):5.1f} %"
                    f"  shown {100 * np.mean(found[who, key]):5.1f} % of {len(held[who, key])}"
                )
            print(f"{key} interval narrower, median {np.median(gain[key]):.2f} times", flush=True)


if __name__ == "__main__":
    main()

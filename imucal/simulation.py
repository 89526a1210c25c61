"""Recordings of known truth: noise models of a gyroscope and an accelerometer -> Recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.noise import NoiseModel
from imucal.recording import Axis, AxisSeries, Recording, Sensor, Source

#: Time of the first simulated sample: 2026-01-01 00:00 UTC, in ns.
START_NS = 1_767_225_600_000_000_000

_AXES: tuple[Axis, ...] = ("x", "y", "z")


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorTruth:
    """What a simulated sensor does.

    Attributes
    ----------
    model
        Noise of each axis, in SI.
    mean
        Constant of the axes x, y, z, in SI.
    lsb
        Resolution of the output, in SI; 0 for none.
    """

    model: NoiseModel
    mean: tuple[float, float, float]
    lsb: float = 0.0

    def samples(self, n: int, *, rate_hz: float, rng: np.random.Generator) -> FloatArray:
        """Return samples, shape (3, n)."""
        rows = [constant + self.model.simulate(n, rate_hz=rate_hz, rng=rng) for constant in self.mean]
        samples = np.stack(rows)
        return np.round(samples / self.lsb) * self.lsb if self.lsb else samples


def simulate_recording(
    *,
    gyroscope: SensorTruth,
    accelerometer: SensorTruth,
    rate_hz: float,
    duration_s: float,
    seed: int,
    gaps_s: Sequence[tuple[float, float]] = (),
) -> Recording:
    """Return a recording of simulated noise.

    Parameters
    ----------
    gyroscope, accelerometer
        The truth.
    rate_hz, duration_s
        Sampling rate and length; at least one sample is made.
    seed
        The same seed gives the same samples.
    gaps_s
        Start and length, in s, of stretches whose samples are lost.

    Raises
    ------
    ValueError
        If no sample is left.
    """
    n = max(1, round(duration_s * rate_hz))
    rng = np.random.default_rng(seed)
    seconds = np.arange(n) / rate_hz
    keep = np.ones(n, dtype=np.bool_)
    for start, length in gaps_s:
        keep &= ~((seconds >= start) & (seconds < start + length))
    if not keep.any():
        msg = "the gaps leave no samples"
        raise ValueError(msg)
    even = Clock.even(n, rate_hz, source="simulated")
    clock = replace(even, start_ns=START_NS, jitter_s=0.0).keeping(keep)
    truths = {Sensor.GYROSCOPE: gyroscope, Sensor.ACCELEROMETER: accelerometer}
    series = tuple(
        AxisSeries(sensor=sensor, axis=axis, samples=row[keep], clock=clock)
        for sensor, truth in truths.items()
        for axis, row in zip(_AXES, truth.samples(n, rate_hz=rate_hz, rng=rng), strict=True)
    )
    return Recording(source=Source(path="simulated", format="simulated"), series=series)

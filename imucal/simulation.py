"""Recordings of known truth: noise models of a gyroscope and an accelerometer -> Recording."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray, blocks
from imucal.clock import Clock
from imucal.noise import NoiseModel
from imucal.readers.store import Room
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
        return np.stack(list(self.rows(n, rate_hz=rate_hz, rng=rng)))

    def rows(self, n: int, *, rate_hz: float, rng: np.random.Generator) -> Iterator[FloatArray]:
        """Yield the samples of the axes x, y, z, each of shape (n,)."""
        for constant in self.mean:
            samples = self.model.simulate(n, rate_hz=rate_hz, rng=rng)
            samples += constant
            if self.lsb:
                samples /= self.lsb
                np.round(samples, out=samples)
                samples *= self.lsb
            yield samples


def simulate_recording(
    *,
    gyroscope: SensorTruth,
    accelerometer: SensorTruth,
    rate_hz: float,
    duration_s: float,
    seed: int,
    gaps_s: Sequence[tuple[float, float]] = (),
) -> Recording:
    """Return a recording of simulated noise; that of a long one lies in temporary files.

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
    keep = np.ones(n, dtype=np.bool_)
    for part in blocks(n):
        seconds = np.arange(part.start, part.stop) / rate_hz
        for start, length in gaps_s:
            keep[part] &= ~((seconds >= start) & (seconds < start + length))
    if not keep.any():
        msg = "the gaps leave no samples"
        raise ValueError(msg)
    even = Clock.even(n, rate_hz, source="simulated")
    clock = replace(even, start_ns=START_NS, jitter_s=0.0).keeping(keep)
    room = Room()
    truths = {Sensor.GYROSCOPE: gyroscope, Sensor.ACCELEROMETER: accelerometer}
    series = tuple(
        AxisSeries(sensor=sensor, axis=axis, samples=room.chosen(row, keep), clock=clock)
        for sensor, truth in truths.items()
        for axis, row in zip(_AXES, truth.rows(n, rate_hz=rate_hz, rng=rng), strict=True)
    )
    return Recording(source=Source(path="simulated", format="simulated"), series=series)

"""A recording with the profiles of its axes, its sensors on even grids, and its rests."""

import math
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.calibration.poses import Triad, find_rests, triad
from imucal.errors import DataError
from imucal.recording import Recording, Sensor
from imucal.screening.windows import Profile, profile

__all__ = ["Stream"]

#: Shortest rest, in s: its mean direction is known to 0.1° with any consumer sensor.
_REST_S = 1.0
#: Largest standard deviation of a resting accelerometer, as a share of gravity. A hand at rest shows 0.01, a
#: walk 0.2; a log that never rests has a quietest part, too.
_STILL = 0.05
#: Share of the windows that are the quiet ones of a log without rests.
_QUIET_SHARE = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Stream:
    """A recording with profiles of the axes that have data, in its order.

    `accelerometer` and `gyroscope` are None if an axis is missing, or never changes. `rests` are start and
    end, shape (m, 2), in s from the first sample of the accelerometer.
    """

    recording: Recording
    profiles: tuple[Profile, ...]
    accelerometer: Triad | None
    gyroscope: Triad | None
    rests: FloatArray

    @classmethod
    def of(cls, recording: Recording) -> "Stream":
        """Return the stream of a recording."""
        profiles = tuple(profile(series) for series in recording.series)
        alive = {p.name for p in profiles if p.windows.size and not p.constant}
        accelerometer = _whole_triad(recording, Sensor.ACCELEROMETER, alive)
        gyroscope = _whole_triad(recording, Sensor.GYROSCOPE, alive)
        return cls(
            recording=recording,
            profiles=profiles,
            accelerometer=accelerometer,
            gyroscope=gyroscope,
            rests=_rests(accelerometer, gyroscope),
        )

    def of_sensor(self, sensor: Sensor) -> tuple[Profile, ...]:
        """Return the profiles of a sensor's axes."""
        return tuple(p for p in self.profiles if p.series.sensor is sensor)

    def offset_s(self, sensor: Sensor) -> float:
        """Return the time of a sensor's first sample, in the time of `rests`."""
        data = self.gyroscope if sensor is Sensor.GYROSCOPE else self.accelerometer
        return data.offset_s if data is not None else 0.0

    def resting(self, one: Profile) -> BoolArray:
        """Return which windows of an axis are within a rest, shape (k,)."""
        start = one.windows.time_s + self.offset_s(one.series.sensor)
        inside = np.zeros(start.size, dtype=np.bool_)
        for first, end in self.rests:
            inside |= (start >= first) & (start + one.windows.length_s <= end)
        return inside

    def quiet(self, sensor: Sensor) -> tuple[Profile, ...]:
        """Return the profiles of a sensor's quiet windows: at rest, or the quietest tenth without rests.

        Empty unless the axes share their windows.
        """
        axes = self.of_sensor(sensor)
        if not axes or len({p.windows.size for p in axes}) != 1 or not axes[0].windows.size:
            return ()
        quiet = self.resting(axes[0])
        if not quiet.any():
            loudness = np.sum([p.windows.variance for p in axes], axis=0)
            quiet = loudness <= np.quantile(loudness, _QUIET_SHARE)
        return tuple(_taking(p, quiet) for p in axes)


def _taking(one: Profile, keep: BoolArray) -> Profile:
    windows = one.windows.take(keep)
    varying = windows.step_variance[windows.variance > 0]
    noise = math.sqrt(float(np.median(varying))) if varying.size else 0.0
    return replace(one, windows=windows, disturbed=np.zeros(windows.size, dtype=np.bool_), noise=noise)


def _whole_triad(recording: Recording, sensor: Sensor, alive: set[str]) -> Triad | None:
    if any(f"{sensor.short}_{axis}" not in alive for axis in "xyz"):
        return None
    try:
        return triad(recording, sensor)
    except DataError:
        return None


def _rests(accelerometer: Triad | None, gyroscope: Triad | None) -> FloatArray:
    """Return the rests that are still in absolute terms, too."""
    nothing = np.zeros((0, 2))
    if accelerometer is None:
        return nothing
    try:
        spans = find_rests(accelerometer, gyroscope, at_least_s=_REST_S)
    except DataError:
        return nothing
    return np.array([span for span in spans if _is_still(accelerometer, span)]).reshape(-1, 2)


def _is_still(accelerometer: Triad, span: FloatArray) -> bool:
    first, end = accelerometer.places(span)
    samples = accelerometer.samples[first:end]
    deviation = float(np.linalg.norm(samples.std(axis=0)))
    return deviation < _STILL * float(np.linalg.norm(samples.mean(axis=0)))

"""Simulated logs of a moving IMU, whose motion is known at any time, and damages to logs."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.recording import AXES, AxisSeries, Recording, Sensor, Source

GRAVITY = 9.80665
#: Step of numerical derivatives of the motion, in s.
_STEP_S = 1e-3

Attitude = Callable[[FloatArray], Rotation]
Place = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Imu:
    """A consumer IMU: noise in SI per sqrt(Hz), steps in SI, and its errors."""

    rate_hz: float = 200.0
    noise_g: float = 1.5e-4
    noise_a: float = 2e-3
    step_g: float = math.radians(2000) / 32768
    step_a: float = 8 * GRAVITY / 32768
    scale: float = 0.01
    misaligned: float = 0.01
    bias_g: float = 0.01
    bias_a: float = 0.1


@dataclass(frozen=True)
class Motion:
    """The rotation from the body to the earth, and the position in the earth, at any time in s."""

    attitude: Attitude
    place: Place
    duration_s: float

    def rates(self, t: FloatArray) -> FloatArray:
        """Return the angular rate in the body, shape (n, 3)."""
        turned = self.attitude(t - _STEP_S).inv() * self.attitude(t + _STEP_S)
        return np.asarray(turned.as_rotvec() / (2 * _STEP_S))

    def forces(self, t: FloatArray) -> FloatArray:
        """Return the specific force in the body, shape (n, 3)."""
        acceleration = self.place(t + _STEP_S) - 2 * self.place(t) + self.place(t - _STEP_S)
        force = acceleration / _STEP_S**2 + [0.0, 0.0, GRAVITY]
        return np.asarray(self.attitude(t).inv().apply(force))


def turns_and_rests(
    rng: np.random.Generator,
    *,
    turns: int = 12,
    rest_s: tuple[float, float] = (1.5, 4.0),
    turn_s: tuple[float, float] = (0.8, 2.5),
    angle: tuple[float, float] = (1.0, 2.4),
    lever_m: float = 0.1,
    carried_m: float = 0.1,
) -> Motion:
    """Return a motion of turns about each axis in order, then about random axes, with rests between.

    `lever_m` is the distance from the point about which the IMU turns; `carried_m` is the distance by which
    it is carried in each turn.
    """
    axes = np.vstack([np.eye(3), rng.normal(size=(max(turns - 3, 0), 3))])[:turns]
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    axes *= rng.choice([-1.0, 1.0], (turns, 1))
    angles = rng.uniform(*angle, turns)
    lengths, rests = rng.uniform(*turn_s, turns), rng.uniform(*rest_s, turns + 1)
    starts = np.cumsum(rests[:-1]) + np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    bases = [Rotation.identity()]
    for axis, size in zip(axes, angles, strict=True):
        bases.append(bases[-1] * Rotation.from_rotvec(axis * size))
    base = Rotation.concatenate(bases)
    lever = rng.normal(0, lever_m, 3)
    carries = np.vstack([np.zeros(3), np.cumsum(rng.normal(0, carried_m, (turns, 3)), axis=0)])

    def progress(t: FloatArray) -> tuple[np.ndarray, FloatArray]:
        k = np.clip(np.searchsorted(starts, t) - 1, 0, turns - 1)
        s = np.clip((t - starts[k]) / lengths[k], 0, 1)
        return k, s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)

    def attitude(t: FloatArray) -> Rotation:
        k, share = progress(t)
        return base[k] * Rotation.from_rotvec(axes[k] * (angles[k] * share)[:, None])

    def place(t: FloatArray) -> FloatArray:
        k, share = progress(t)
        carried = carries[k] + (carries[k + 1] - carries[k]) * share[:, None]
        return np.asarray(carried + attitude(t).apply(lever))

    return Motion(attitude, place, float(starts[-1] + lengths[-1] + rests[-1]))


def swaying(
    rng: np.random.Generator,
    *,
    duration_s: float = 60.0,
    sway: float = 0.8,
    band_hz: tuple[float, float] = (0.1, 0.6),
    carried_m: float = 0.05,
    carried_hz: tuple[float, float] = (0.3, 1.0),
) -> Motion:
    """Return a motion without rests: each angle and coordinate is a sum of five sines."""
    angle_f, angle_a, angle_p = _sines(rng, band_hz, sway)
    place_f, place_a, place_p = _sines(rng, carried_hz, carried_m)

    def attitude(t: FloatArray) -> Rotation:
        angles = (angle_a * np.sin(angle_f * t[:, None, None] + angle_p)).sum(axis=2)
        return Rotation.from_euler("ZYX", angles)

    def place(t: FloatArray) -> FloatArray:
        return np.asarray((place_a * np.sin(place_f * t[:, None, None] + place_p)).sum(axis=2))

    return Motion(attitude, place, duration_s)


def walking(rng: np.random.Generator, *, duration_s: float = 60.0) -> Motion:
    """Return a walk: 2 steps per second with 3 m/s², and some turning of the body."""
    sway = swaying(rng, duration_s=duration_s, sway=0.15, carried_m=0.0)
    step_hz = rng.uniform(1.7, 2.2)
    size = np.array([1.0, 1.5, 3.0]) / (2 * math.pi * step_hz) ** 2
    phase = rng.uniform(0, 6, 3)

    def place(t: FloatArray) -> FloatArray:
        wt = 2 * math.pi * step_hz * t[:, None]
        return np.asarray(size * (np.sin(wt + phase) + 0.3 * np.sin(2 * wt + phase)))

    return Motion(sway.attitude, place, duration_s)


def _sines(
    rng: np.random.Generator, band_hz: tuple[float, float], size: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    frequency = 2 * math.pi * rng.uniform(*band_hz, (3, 5))
    return frequency, rng.normal(0, size / math.sqrt(5), (3, 5)), rng.uniform(0, 2 * math.pi, (3, 5))


@dataclass(frozen=True)
class Samples:
    """Samples of both sensors, shape (n, 3), at one rate."""

    gyroscope: FloatArray
    accelerometer: FloatArray
    rate_hz: float

    def recording(self) -> Recording:
        """Return them as if read from a file."""
        clock = Clock.even(len(self.gyroscope), self.rate_hz)
        sensors = ((Sensor.GYROSCOPE, self.gyroscope), (Sensor.ACCELEROMETER, self.accelerometer))
        series = tuple(
            AxisSeries(sensor=sensor, axis=axis, samples=samples[:, k], clock=clock)
            for sensor, samples in sensors
            for k, axis in enumerate(AXES)
        )
        return Recording(source=Source(path="simulated", format="simulated"), series=series)

    def mapped(self, order: FloatArray) -> "Samples":
        """Return the samples of a gyroscope whose axes measure these axes of the accelerometer."""
        return replace(self, gyroscope=self.gyroscope @ order.T)


def sampled(
    motion: Motion,
    rng: np.random.Generator,
    imu: Imu | None = None,
    *,
    delay_s: float = 0.0,
    vibration: tuple[float, float] = (0.0, 0.0),
) -> Samples:
    """Return what an IMU measures; its accelerometer is late by `delay_s`.

    `vibration` is the standard deviation of a propeller's lines at 83 and 166 Hz, of the gyroscope and of the
    accelerometer, in SI.
    """
    imu = imu or Imu()
    t = np.arange(round(motion.duration_s * imu.rate_hz)) / imu.rate_hz
    w, f = motion.rates(t), motion.forces(t - delay_s)
    for values, size in zip((w, f), vibration, strict=True):
        phase = rng.uniform(0, 6, (2, 3))
        for k, frequency in enumerate((83.3, 166.6)):
            np.add(values, size * np.sin(2 * math.pi * frequency * t[:, None] + phase[k]), out=values)
    return Samples(
        gyroscope=_measured(w, rng, imu, density=imu.noise_g, bias=imu.bias_g, step=imu.step_g),
        accelerometer=_measured(f, rng, imu, density=imu.noise_a, bias=imu.bias_a, step=imu.step_a),
        rate_hz=imu.rate_hz,
    )


def _measured(
    true: FloatArray, rng: np.random.Generator, imu: Imu, *, density: float, bias: float, step: float
) -> FloatArray:
    matrix = np.eye(3) + np.diag(rng.normal(0, imu.scale, 3)) + rng.normal(0, imu.misaligned, (3, 3))
    noise = rng.normal(0, density * math.sqrt(imu.rate_hz), true.shape)
    values = true @ matrix.T + rng.normal(0, bias, 3) + noise
    return np.asarray(np.round(values / step) * step) if step else values

"""Logs of rests and turns of known truth, and the precision to expect from one."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays
from imucal.calibration.accelerometer import describe_direction, faces_edges_corners
from imucal.calibration.frames import Frame
from imucal.calibration.gravity import earth_rate, gravity_at
from imucal.calibration.gyro_rest import estimate_gyro_rest
from imucal.calibration.mean_covariance import mean_covariance
from imucal.calibration.parameters import Parameter, accelerometer_parameters, gyroscope_parameters
from imucal.calibration.poses import RestMeans, Triad
from imucal.calibration.requirements import MIN_RESTS
from imucal.calibration.slow_noise import estimate_accelerometer, walk_covariance
from imucal.calibration.turn_data import Headings, prepare_turns, rotations
from imucal.calibration.turns import GyroNoise, direction_covariance, fit_turns
from imucal.clock import Clock
from imucal.errors import ArgumentError
from imucal.noise import NoiseModel
from imucal.recording import AXES, AxisSeries, Recording, Sensor, Source

__all__ = ["ImuErrors", "RestsPlan", "plan_rests", "simulate_rests"]

#: Errors of a consumer IMU: scale, misalignment in rad, biases and g-sensitivity in SI.
_SCALE, _MISALIGNED, _BIAS_A, _BIAS_G, _G = 0.01, 0.01, 0.15, 0.01, 1e-4
#: Tilt of an attitude, in rad; length of a turn in s, and its yaw, in rad.
_TILT, _TURN_S, _YAW = 0.08, 2.0, 0.6
_FACES = np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1], [0, 1, 0], [-1, 0, 0], [0, -1, 0.0]])


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuErrors(ReadOnlyArrays):
    """Known errors: raw_a = M_a f + b_a, raw_g = M_g w + b_g + G f, in SI.

    The biases include the mean of slow noise over the log.
    """

    M_a: FloatArray
    b_a: FloatArray
    M_g: FloatArray
    b_g: FloatArray
    G: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class _Motion(ReadOnlyArrays):
    """True specific force and rate, each (n, 3); spans of the rests in samples, (m, 2), and up, (m, 3)."""

    f: FloatArray
    w: FloatArray
    spans: IntArray
    up: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RestsPlan:
    """A planned log: attitudes in words, and each parameter with its expected interval."""

    rest_s: float
    rate_hz: float
    duration_s: float
    attitudes: tuple[str, ...]
    accelerometer: Mapping[str, Parameter]
    gyroscope: Mapping[str, Parameter]


def simulate_rests(
    models: tuple[NoiseModel, NoiseModel],
    count: int,
    *,
    rest_s: float = 5.0,
    rate_hz: float = 100.0,
    seed: int = 0,
    lsb: tuple[float, float] = (0.0, 0.0),
) -> tuple[Recording, ImuErrors]:
    """Return a log of rests with smooth turns between, and the errors of its IMU, drawn with the seed.

    `models` and `lsb`, the resolution, are of the gyroscope and of the accelerometer. Fewer than 6 rests, or
    16 samples of a rest, raise an ArgumentError.
    """
    rng = np.random.default_rng(seed)
    motion = _motion(_up(count, rng), rng, rest_s=rest_s, rate_hz=rate_hz)
    n = len(motion.f)
    M_a = np.eye(3) + np.diag(rng.normal(0, _SCALE, 3)) + np.tril(rng.normal(0, _MISALIGNED, (3, 3)), -1)
    M_g = np.eye(3) + rng.normal(0, _SCALE, (3, 3))
    G = rng.normal(0, _G, (3, 3))
    (e_g, drift_g), (e_a, drift_a) = (_drawn_noise(model, n, rate_hz, rng) for model in models)
    b_g = rng.normal(0, _BIAS_G, 3)
    b_a = rng.normal(0, _BIAS_A, 3)
    raw = {
        Sensor.GYROSCOPE: motion.w @ M_g.T + motion.f @ G.T + b_g + e_g,
        Sensor.ACCELEROMETER: motion.f @ M_a.T + b_a + e_a,
    }
    clock = Clock.even(n, rate_hz, source="simulated")
    series = tuple(
        AxisSeries(sensor=sensor, axis=axis, samples=_rounded(samples[:, k], step), clock=clock)
        for (sensor, samples), step in zip(raw.items(), lsb, strict=True)
        for k, axis in enumerate(AXES)
    )
    errors = ImuErrors(M_a=M_a, b_a=b_a + drift_a, M_g=M_g, b_g=b_g + drift_g, G=G)
    return Recording(source=Source(path="simulated", format="simulated"), series=series), errors


def plan_rests(
    models: Mapping[str, NoiseModel],
    count: int,
    *,
    rest_s: float = 5.0,
    rate_hz: float = 100.0,
    latitude: float | None = None,
) -> RestsPlan:
    """Return the attitudes of a log with `count` rests, and the intervals to expect.

    The sensor is taken as perfect and its noise as known. Fewer than 9 rests do not determine misalignments.
    Fewer than 6 rests, or an accelerometer without model, raise an ArgumentError.
    """
    own = {
        sensor: tuple(models[name] for axis in AXES if (name := f"{sensor.short}_{axis}") in models)
        for sensor in Sensor
    }
    if len(own[Sensor.ACCELEROMETER]) != len(AXES):
        raise ArgumentError("a calibration needs the noise of the accelerometer's three axes")
    rng = np.random.default_rng(0)
    motion = _motion(_up(count, rng), rng, rest_s=rest_s, rate_hz=rate_hz)
    up, n, spans, place = motion.up, len(motion.f), motion.spans, gravity_at(latitude=latitude)
    base = {
        sensor: np.array([mean_covariance(m, spans, rate_hz=rate_hz, samples=n) for m in of_sensor])
        for sensor, of_sensor in own.items()
    }
    walk = walk_covariance(spans, rate_hz=rate_hz, samples=n)
    means = up * place.value
    estimate = estimate_accelerometer(
        means, base[Sensor.ACCELEROMETER], walk,
        gravity=place.value, gravity_sigma=place.sigma, checked=True,
    )  # fmt: skip
    frame = Frame.of("kalibr", estimate.fit.C)
    gyroscope: Mapping[str, Parameter] = {}
    if len(own[Sensor.GYROSCOPE]) == len(AXES):
        earth = earth_rate(latitude)
        rests = RestMeans(spans=spans, means=np.zeros_like(means), deviations=np.zeros(3))
        data = Triad(sensor=Sensor.GYROSCOPE, samples=motion.w, rate_hz=rate_hz)
        turns = prepare_turns(data, rests, up, np.arange(count - 1))
        headings = Headings.of(turns, np.eye(3))
        rest = estimate_gyro_rest(
            rests.means, means, base[Sensor.GYROSCOPE], walk,
            scale=np.eye(3), earth=earth, gravity=place.value, checked=True, headings=headings,
        )  # fmt: skip
        noise = GyroNoise(
            models=own[Sensor.GYROSCOPE], tau=np.zeros(3), rest_spans=spans, samples=n,
            headings=headings, horizontal=earth.horizontal_sigma,
        )  # fmt: skip
        directions = direction_covariance(estimate.fit, means, estimate.covariances)
        gyroscope = gyroscope_parameters(rest, fit_turns(turns, noise, directions))
    return RestsPlan(
        rest_s=rest_s,
        rate_hz=rate_hz,
        duration_s=n / rate_hz,
        attitudes=tuple(describe_direction(-one) for one in _ideal(count)),
        accelerometer=accelerometer_parameters(estimate, frame),
        gyroscope=gyroscope,
    )


def _drawn_noise(
    model: NoiseModel, n: int, rate_hz: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return noise of three axes, shape (n, 3), and the mean of all but its white noise, shape (3,)."""
    white, slow = np.zeros((n, 3)), np.zeros((n, 3))
    for axis in range(3):
        for term in model.terms:
            part = white if term.symbol == "N" else slow
            part[:, axis] += NoiseModel(terms=(term,)).simulate(n, rate_hz=rate_hz, rng=rng)
    return white + slow, slow.mean(axis=0)


def _ideal(count: int) -> FloatArray:
    """Return up directions: six faces, twelve edges, eight corners, then again."""
    every = np.vstack([_FACES, faces_edges_corners()[6:]])
    return np.asarray(every[np.arange(count) % len(every)])


def _up(count: int, rng: np.random.Generator) -> FloatArray:
    if count < MIN_RESTS:
        raise ArgumentError(f"{count} rests can't be calibrated; expected {MIN_RESTS} or more")
    found = _ideal(count) + rng.normal(0, _TILT, (count, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


def _motion(up: FloatArray, rng: np.random.Generator, *, rest_s: float, rate_hz: float) -> _Motion:
    rest, turn = round(rest_s * rate_hz), max(8, round(_TURN_S * rate_hz))
    if rest < 16:
        raise ArgumentError(
            f"a rest of {rest_s:g} s has {rest} samples at {rate_hz:g} Hz, expected 16 or more"
        )
    bell = 1 - np.cos(2 * math.pi * (np.arange(turn) + 0.5) / turn)
    bell *= rate_hz / bell.sum()
    done = np.concatenate([[0.0], np.cumsum(bell)[:-1]]) / rate_hz
    v = up[0]
    rates, directions, at_rest = [np.zeros((rest, 3))], [np.tile(v, (rest, 1))], [v]
    for target in up[1:]:
        axis = np.cross(v, target)
        sine = float(np.linalg.norm(axis))
        # Opposite directions have no common plane.
        if sine < 1e-6:
            axis = np.cross(v, [0.6, 0.0, 0.8])
        axis /= np.linalg.norm(axis)
        angle = math.atan2(sine, float(v @ target))
        # Turning about the vertical changes no direction.
        path = rotations(axis * (angle * done)[:, None]) @ v
        w = -axis * (angle * bell)[:, None] + (rng.normal(0, _YAW) * bell)[:, None] * path
        rates += [w, np.zeros((rest, 3))]
        carried = np.empty((turn, 3))
        for k, step in enumerate(rotations(-w / rate_hz)):
            carried[k] = v
            v = step @ v
        directions += [carried, np.tile(v, (rest, 1))]
        at_rest.append(v)
    first = np.arange(len(up)) * (rest + turn)
    gravity = gravity_at().value
    spans = np.column_stack([first, first + rest])
    return _Motion(f=gravity * np.vstack(directions), w=np.vstack(rates), spans=spans, up=np.array(at_rest))


def _rounded(samples: FloatArray, step: float) -> FloatArray:
    return np.asarray(np.round(samples / step) * step) if step else samples

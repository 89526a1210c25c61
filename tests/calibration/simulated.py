"""Simulated rests and logs of an IMU with known errors."""

import math
from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.calibration.accelerometer import LOWER
from imucal.calibration.gravity import EARTH_RATE
from imucal.calibration.turn_data import rotations
from imucal.clock import Clock
from imucal.noise import NoiseModel
from imucal.recording import AXES, AxisSeries, Recording, Sensor, Source

GRAVITY = 9.80665
RATE = 100.0
FACES = np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1], [0, 1, 0], [-1, 0, 0], [0, -1, 0.0]])
_EDGES = np.array(
    [FACES[i] + FACES[j] for i in range(6) for j in range(i + 1, 6) if abs(FACES[i] @ FACES[j]) < 0.5]
)


@dataclass(frozen=True, slots=True)
class Truth:
    """Errors of an IMU: raw_a = M_a f + b_a, raw_g = M_g w + b_g + G f."""

    M_a: FloatArray
    b_a: FloatArray
    M_g: FloatArray
    b_g: FloatArray
    G: FloatArray

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Truth":
        """Return the errors of a consumer IMU: 1 % scale, 0.01 rad misalignment, 0.15 m/s², 0.01 rad/s."""
        M_a = np.eye(3) + np.diag(rng.normal(0, 0.01, 3)) + np.tril(rng.normal(0, 0.01, (3, 3)), -1)
        M_g = np.eye(3) + rng.normal(0, 0.01, (3, 3))
        return cls(M_a, rng.normal(0, 0.15, 3), M_g, rng.normal(0, 0.01, 3), rng.normal(0, 1e-4, (3, 3)))


@dataclass(frozen=True, slots=True)
class Rests:
    """Means of rests, their spans in samples, the log's length, and the true parameters."""

    means: FloatArray
    spans: IntArray
    samples: int
    true: FloatArray
    deviations: FloatArray


def attitudes(count: int, rng: np.random.Generator, *, tilt: float = 0.08) -> FloatArray:
    """Return up directions: faces first, then edges, each tilted by `tilt` rad as a hand does."""
    found = np.vstack([FACES, _EDGES[rng.permutation(len(_EDGES))]])[np.arange(count) % 18]
    found = found + rng.normal(0, tilt, (count, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


def spans_of(count: int, rest_s: float, turn_s: float = 3.0) -> IntArray:
    """Return first sample and end of equal rests, shape (count, 2)."""
    rest, turn = int(rest_s * RATE), int(turn_s * RATE)
    first = np.arange(count) * (rest + turn)
    return np.column_stack([first, first + rest])


def accelerometer_rests(
    model: NoiseModel, count: int, rest_s: float, rng: np.random.Generator, up: FloatArray | None = None
) -> Rests:
    """Return the means of rests of a drawn accelerometer whose axes have this noise."""
    truth = Truth.draw(rng)
    spans = spans_of(count, rest_s)
    samples = int(spans[-1, 1])
    up = attitudes(count, rng) if up is None else up
    noise = np.column_stack([model.simulate(samples, rate_hz=RATE, rng=rng) for _ in range(3)])
    at_rest = [noise[a:b] for a, b in spans]
    means = up * GRAVITY @ truth.M_a.T + truth.b_a + np.array([part.mean(axis=0) for part in at_rest])
    return Rests(
        means=means,
        spans=spans,
        samples=samples,
        true=np.concatenate([np.linalg.inv(truth.M_a)[LOWER], truth.b_a + noise.mean(axis=0)]),
        deviations=np.sqrt(np.mean([part.var(axis=0, ddof=1) for part in at_rest], axis=0)),
    )


@dataclass(frozen=True, slots=True)
class Log:
    """A log: raw samples (n, 3), rests in samples (m, 2), true specific force and biases."""

    accelerometer: FloatArray
    gyroscope: FloatArray
    spans: IntArray
    f: FloatArray
    b_a: FloatArray
    b_g: FloatArray

    def recording(self, rate_hz: float = RATE) -> Recording:
        """Return it as if read from a file."""
        clock = Clock.even(len(self.f), rate_hz)
        series = tuple(
            AxisSeries(sensor=sensor, axis=axis, samples=samples[:, k], clock=clock)
            for sensor, samples in (
                (Sensor.GYROSCOPE, self.gyroscope),
                (Sensor.ACCELEROMETER, self.accelerometer),
            )
            for k, axis in enumerate(AXES)
        )
        return Recording(source=Source(path="simulated", format="simulated"), series=series)


def log(
    truth: Truth,
    noise: tuple[NoiseModel, NoiseModel],
    up: FloatArray,
    rng: np.random.Generator,
    *,
    rest_s: float = 5.0,
    turn_s: float = 2.0,
    latitude: float | None = None,
) -> Log:
    """Return a log of rests with these up directions and smooth turns between, which also yaw.

    `noise` is that of an accelerometer's and a gyroscope's axes. With a latitude the earth turns.
    """
    rest, turn = int(rest_s * RATE), int(turn_s * RATE)
    bell = 1 - np.cos(2 * np.pi * (np.arange(turn) + 0.5) / turn)
    bell *= RATE / bell.sum()
    v, rates, directions = up[0], [np.zeros((rest, 3))], [np.tile(up[0], (rest, 1))]
    # Axes of the body in an earth-fixed frame: up, and a horizontal direction.
    north = np.cross(v, [0.6, 0.0, 0.8])
    north /= np.linalg.norm(north)
    norths = [np.tile(north, (rest, 1))]
    for target in up[1:]:
        axis = np.cross(v, target)
        sine = np.linalg.norm(axis)
        axis = axis / sine if sine > 1e-6 else np.cross(v, [0.6, 0.0, 0.8])
        axis /= np.linalg.norm(axis)
        angle = np.arctan2(sine, v @ target)
        done = angle * np.concatenate([[0.0], np.cumsum(bell)[:-1]]) / RATE
        rate = -axis * angle * bell[:, None]
        # Turning about the vertical does not change its direction.
        rate += (rng.normal(0, 0.6) * bell)[:, None] * (rotations(axis * done[:, None]) @ v)
        path, ends = np.empty((turn, 3)), np.empty((turn, 3))
        for k, step in enumerate(rotations(-rate / RATE)):
            v, north = step @ v, step @ north
            path[k], ends[k] = v, north
        rates += [rate, np.zeros((rest, 3))]
        directions += [path, np.tile(v, (rest, 1))]
        norths += [ends, np.tile(north, (rest, 1))]
    w, f = np.vstack(rates), np.vstack(directions) * GRAVITY
    if latitude is not None:
        phi = math.radians(latitude)
        w += EARTH_RATE * (math.sin(phi) * f / GRAVITY + math.cos(phi) * np.vstack(norths))
    e_a, e_g = (
        np.column_stack([model.simulate(len(f), rate_hz=RATE, rng=rng) for _ in range(3)]) for model in noise
    )
    first = np.arange(len(up)) * (rest + turn)
    return Log(
        accelerometer=f @ truth.M_a.T + truth.b_a + e_a,
        gyroscope=w @ truth.M_g.T + truth.b_g + f @ truth.G.T + e_g,
        spans=np.column_stack([first, first + rest]),
        f=f,
        b_a=truth.b_a + e_a.mean(axis=0),
        b_g=truth.b_g + e_g.mean(axis=0),
    )


def covered(theta: FloatArray, intervals: FloatArray, true: FloatArray) -> BoolArray:
    """Return which true values lie in the intervals, given relative to theta."""
    return np.asarray((theta + intervals[:, 0] <= true) & (true <= theta + intervals[:, 1]))


def within_binomial(hits: BoolArray, low: float, high: float) -> bool:
    """Return whether a coverage lies between two limits, give or take three deviations of its draws.

    Parameters of one draw are correlated: draws count, not parameters.
    """
    per_draw = hits.mean(axis=1)
    error = 3 * max(float(per_draw.std(ddof=1)), 0.02) / math.sqrt(len(hits))
    return low - error <= float(per_draw.mean()) <= high + error

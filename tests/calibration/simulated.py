"""Simulated rests and logs of an IMU with known errors."""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.calibration import Calibration
from imucal.calibration.accelerometer import LOWER
from imucal.calibration.frames import rotation_to
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


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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


def drawn_noise(model: NoiseModel, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return noise of three axes, shape (n, 3), and the mean of its slow terms, which is part of the bias."""
    white, slow = np.zeros((n, 3)), np.zeros((n, 3))
    for axis in range(3):
        for term in model.terms:
            part = white if term.symbol == "N" else slow
            part[:, axis] += NoiseModel(terms=(term,)).simulate(n, rate_hz=RATE, rng=rng)
    return white + slow, slow.mean(axis=0)


def accelerometer_rests(
    model: NoiseModel, count: int, rest_s: float, rng: np.random.Generator, up: FloatArray | None = None
) -> Rests:
    """Return the means of rests of a drawn accelerometer whose axes have this noise."""
    truth = Truth.draw(rng)
    spans = spans_of(count, rest_s)
    samples = int(spans[-1, 1])
    up = attitudes(count, rng) if up is None else up
    noise, drift = drawn_noise(model, samples, rng)
    at_rest = [noise[a:b] for a, b in spans]
    means = up * GRAVITY @ truth.M_a.T + truth.b_a + np.array([part.mean(axis=0) for part in at_rest])
    return Rests(
        means=means,
        spans=spans,
        samples=samples,
        true=np.concatenate([np.linalg.inv(truth.M_a)[LOWER], truth.b_a + drift]),
        deviations=np.sqrt(np.mean([part.var(axis=0, ddof=1) for part in at_rest], axis=0)),
    )


@dataclass(frozen=True)
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
    yaw: float = 0.6,
    yaws: FloatArray | None = None,
) -> Log:
    """Return a log of rests with these up directions and smooth turns between, which also yaw.

    `noise` is that of an accelerometer's and a gyroscope's axes. With a latitude the earth turns. `yaws`,
    shape (m - 1,), are the angles about the vertical of the turns, in rad, by default drawn with the
    deviation `yaw`.
    """
    rest, turn = int(rest_s * RATE), int(turn_s * RATE)
    bell = 1 - np.cos(2 * np.pi * (np.arange(turn) + 0.5) / turn)
    bell *= RATE / bell.sum()
    v, rates, directions = up[0], [np.zeros((rest, 3))], [np.tile(up[0], (rest, 1))]
    # Axes of the body in an earth-fixed frame: up, and a horizontal direction.
    north = np.cross(v, [0.6, 0.0, 0.8])
    north /= np.linalg.norm(north)
    norths = [np.tile(north, (rest, 1))]
    drawn = rng.normal(0, yaw, len(up) - 1) if yaws is None else yaws
    for target, about_vertical in zip(up[1:], drawn, strict=True):
        axis = np.cross(v, target)
        sine = np.linalg.norm(axis)
        axis = axis / sine if sine > 1e-6 else np.cross(v, [0.6, 0.0, 0.8])
        axis /= np.linalg.norm(axis)
        angle = np.arctan2(sine, v @ target)
        done = angle * np.concatenate([[0.0], np.cumsum(bell)[:-1]]) / RATE
        rate = -axis * angle * bell[:, None]
        # Turning about the vertical does not change its direction.
        rate += (about_vertical * bell)[:, None] * (rotations(axis * done[:, None]) @ v)
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
    (e_a, drift_a), (e_g, drift_g) = (drawn_noise(model, len(f), rng) for model in noise)
    first = np.arange(len(up)) * (rest + turn)
    return Log(
        accelerometer=f @ truth.M_a.T + truth.b_a + e_a,
        gyroscope=w @ truth.M_g.T + truth.b_g + f @ truth.G.T + e_g,
        spans=np.column_stack([first, first + rest]),
        f=f,
        b_a=truth.b_a + drift_a,
        b_g=truth.b_g + drift_g,
    )


def ferraris(
    truth: Truth,
    noise: tuple[NoiseModel, NoiseModel],
    rng: np.random.Generator,
    *,
    tilt: float = 0.02,
    deviation: float = 0.0,
) -> Log:
    """Return a log of six faces, and of one full turn on the table about each axis.

    Source: Ferraris, Grimaldi, Parvis (1995), Sensors and Materials 7, 311. `tilt` is of each face, in rad;
    each full turn is wrong by a drawn angle with `deviation`, in rad.
    """
    faces = FACES[[0, 2, 1, 4, 3, 5, 1, 3, 0]] + rng.normal(0, tilt, (9, 3))
    faces /= np.linalg.norm(faces, axis=1)[:, None]
    # The last three faces: a rest, a full turn, and a rest.
    up = faces[[0, 1, 2, 3, 4, 5, 6, 6, 7, 7, 8, 8]]
    yaws = rng.normal(0, 0.6, len(up) - 1)
    yaws[[6, 8, 10]] = 2 * np.pi + rng.normal(0, deviation, 3) if deviation else 2 * np.pi
    return log(truth, noise, up, rng, turn_s=4.0, yaws=yaws)


def held(one: Log, truth: Truth, rng: np.random.Generator, *, size: float = 1.0) -> Log:
    """Return the log of an IMU that a resting hand holds.

    At rest it sways at 0.2 to 1.5 Hz (1.5 mrad, 5 mm/s²) and trembles at 8 to 10 Hz (0.1 mrad, 50 mm/s²),
    each times `size`. Both begin and end at zero with the rest.
    """
    w, f = np.zeros_like(one.f), one.f.copy()
    for first, end in one.spans:
        n = end - first
        window = np.minimum(1.0, 4 * np.sin(np.pi * (np.arange(n) + 0.5) / n))[:, None]
        slow, fast = ((0.2, 1.5), (8.0, 10.0))
        angle = size * window * (1.5e-3 * _band(n, slow, rng) + 1e-4 * _band(n, fast, rng))
        force = size * window * (5e-3 * _band(n, slow, rng) + 5e-2 * _band(n, fast, rng))
        w[first:end] = np.gradient(angle, axis=0) * RATE
        f[first:end] = np.einsum("nij,nj->ni", rotations(-angle), f[first:end]) + force
    return replace(
        one,
        f=f,
        accelerometer=one.accelerometer + (f - one.f) @ truth.M_a.T,
        gyroscope=one.gyroscope + w @ truth.M_g.T + (f - one.f) @ truth.G.T,
    )


def _band(n: int, band: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """Return three axes of noise within a band in Hz, with a deviation of 1, shape (n, 3)."""
    f = np.fft.rfftfreq(n, 1 / RATE)
    inside_band = (f >= band[0]) & (f <= band[1])
    drawn = np.fft.irfft(np.fft.rfft(rng.normal(size=(n, 3)), axis=0) * inside_band[:, None], n, axis=0)
    return np.asarray(drawn * math.sqrt(n / (2 * max(int(inside_band.sum()), 1))))


def warmed(one: Log, size: tuple[float, float], time_s: float) -> Log:
    """Return the log with biases that settle exponentially by `size` (m/s², rad/s) within some `time_s`."""
    settling = np.exp(-np.arange(len(one.f)) / RATE / time_s)[:, None] * np.array([1.0, -0.6, 0.4])
    a, g = (s * settling for s in size)
    return replace(
        one,
        accelerometer=one.accelerometer + a,
        gyroscope=one.gyroscope + g,
        b_a=one.b_a + a.mean(axis=0),
        b_g=one.b_g + g.mean(axis=0),
    )


def truth_inside(truth: Truth, one: Log, result: Calibration) -> dict[str, bool]:
    """Return which intervals contain the truth of their frame, such as ``a scale_x`` or ``g bias_z``."""
    R = rotation_to(result.frame, np.asarray(np.linalg.inv(truth.M_a), dtype=np.float64))
    assert result.gyroscope is not None
    found, axes = {}, "xyz"
    for sensor, M, b, own in (
        ("a", truth.M_a @ R.T, one.b_a, result.accelerometer.parameters),
        ("g", truth.M_g @ R.T, one.b_g, result.gyroscope.parameters),
    ):
        true = {
            f"misalignment_{axes[i]}{axes[j]}": math.degrees(M[i, j] / M[i, i])
            for i, j in product(range(3), repeat=2)
        }
        G = truth.G @ R.T
        true |= {f"g_sensitivity_{axes[i]}{axes[j]}": G[i, j] for i, j in product(range(3), repeat=2)}
        for i, axis in enumerate(axes):
            true |= {f"scale_{axis}": 100 * (M[i, i] - 1), f"bias_{axis}": b[i]}
        for name, parameter in own.items():
            if parameter.low is not None and parameter.high is not None:
                found[f"{sensor} {name}"] = bool(parameter.low <= true[name] <= parameter.high)
    return found


def covered(theta: FloatArray, intervals: FloatArray, true: FloatArray) -> BoolArray:
    """Return which true values lie in the intervals, given relative to theta."""
    return np.asarray((theta + intervals[:, 0] <= true) & (true <= theta + intervals[:, 1]))


def within_binomial(hits: BoolArray | FloatArray, low: float, high: float) -> bool:
    """Return whether a coverage lies between two limits, give or take three deviations of its draws.

    `hits` has a row for each draw: hits, or one share of them.
    Parameters of one draw are correlated: draws count, not parameters.
    """
    per_draw = hits.mean(axis=1)
    error = 3 * max(float(per_draw.std(ddof=1)), 0.02) / math.sqrt(len(hits))
    return low - error <= float(per_draw.mean()) <= high + error

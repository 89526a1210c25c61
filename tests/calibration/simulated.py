"""Simulated rests and logs of an IMU with known errors."""

import math
from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.calibration.accelerometer import LOWER
from imucal.noise import NoiseModel

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

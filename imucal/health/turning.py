"""Parts of a log in which the IMU turns, and how well the gyroscope explains the accelerometer there.

In a part of some seconds the specific force is f = R g₀ + a, where the gyroscope gives R, the rotation since
its start, and g₀ is an unknown vector. At a distance r from a fixed point, a = ω' × r + ω × (ω × r). Both g₀
and r are linear parameters. Samples count less, the more the length of f differs from gravity, because the
IMU is then accelerated: moments of rest or slow rotation decide.
"""

import math
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from scipy.interpolate import CubicSpline

from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from imucal.calibration.poses import Triad
from imucal.calibration.turn_data import rotations
from imucal.units import G0

__all__ = ["MODEL_ERROR", "PROPER", "Turning", "turning_parts"]

#: Rate of the means that are compared, in Hz: hands and bodies move below 10 Hz.
_RATE_HZ = 60.0
#: Length of a part, in s: a bias of 0.01 rad/s turns gravity by 2° in it.
_PART_S = 3.0
#: Largest number of parts; they are the ones that turn most.
_MOST_PARTS = 60
#: Least spread of the force in a part, as a share of gravity: that of a turn by 35°.
_LEAST_SPREAD = 0.15
#: Difference between the length of f and gravity, as a share of gravity, that halves the weight of a sample.
_ACCELERATED = 0.05
#: Usual distance from the point about which a hand or a body turns, in m.
_LEVER_M = 0.3
#: Error of f by misalignment and slow translation, as a share of gravity; weighs the usual distance.
MODEL_ERROR = 0.03

#: The 24 rotations among the 48 signed permutations of three axes, shape (24, 3, 3).
PROPER: FloatArray = np.array(
    [
        matrix
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
        if np.linalg.det(matrix := np.diag(signs) @ np.eye(3)[list(order)]) > 0
    ]
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Turning(ReadOnlyArrays):
    """Parts of a log that turn, on a grid of `step_s`.

    `rates` in the gyroscope's unit, minus its mean at rest, and `forces` as shares of gravity have shape
    (b, n, 3), `weights` (b, n), and `times_s`, of the samples, (b, n). `force_at` returns forces at any time
    in s. `lever_m` is the usual distance from the point about which the IMU turns.
    """

    rates: FloatArray
    forces: FloatArray
    weights: FloatArray
    times_s: FloatArray
    step_s: float
    force_at: CubicSpline
    lever_m: float = _LEVER_M

    @property
    def size(self) -> int:
        """Number of parts."""
        return len(self.rates)

    def rotated(self, rates: FloatArray) -> FloatArray:
        """Return the rotation of the earth's vectors since the start of each part, shape (b, n, 3, 3)."""
        between = (rates[:, 1:] + rates[:, :-1]) / 2
        return _products(rotations(-self.step_s * np.pad(between, ((0, 0), (1, 0), (0, 0)))))

    def levers(self, rates: FloatArray) -> FloatArray:
        """Return the forces at the usual distance along each axis, in shares of gravity, (b, n, 3, 3)."""
        alpha = np.gradient(rates, self.step_s, axis=1)
        w = _crosses(rates)
        return np.asarray((_crosses(alpha) + w @ w) * (self.lever_m / G0))

    def design(self, rates: FloatArray) -> FloatArray:
        """Return an orthonormal basis of the forces that rates in rad/s explain, shape (b, 3n + 3, 6).

        The last three rows of a part are the usual distance.
        """
        b, n, _ = rates.shape
        columns = np.concatenate([self.rotated(rates), self.levers(rates)], axis=3)
        weighted = columns * np.sqrt(self.weights)[:, :, None, None]
        usual = np.zeros((b, 3, 6))
        usual[:, :, 3:] = MODEL_ERROR * np.eye(3)
        basis, _ = np.linalg.qr(np.concatenate([weighted.reshape(b, 3 * n, 6), usual], axis=1))
        return np.asarray(basis)

    def unexplained(self, scale: float) -> FloatArray:
        """Return the unexplained share of the variance of f for each rotation of the axes, shape (b, 24)."""
        return self.residuals(self.design(scale * self.rates), self.forces, PROPER) / self.variance[:, None]

    @property
    def variance(self) -> FloatArray:
        """Sum of the weighted squares of f about its mean, shape (b,)."""
        total = self.weights.sum(axis=1)
        mean = np.einsum("bn,bni->bi", self.weights, self.forces) / total[:, None]
        return np.asarray(np.einsum("bn,bni->b", self.weights, (self.forces - mean[:, None]) ** 2))

    def residuals(self, design: FloatArray, forces: FloatArray, turned: FloatArray) -> FloatArray:
        """Return the sum of squares that a design leaves, for f turned by some matrices, shape (b, k)."""
        b, n, _ = forces.shape
        weighted = forces * np.sqrt(self.weights)[..., None]
        # w = Q w' gives Qᵀ f = R[w'] Qᵀ g₀. The sums over samples are the same for all Q.
        squares = weighted.transpose(0, 2, 1) @ weighted
        total = np.einsum("kji,bjl,kli->bk", turned, squares, turned, optimize=True)
        basis = design[:, : 3 * n].reshape(b, n, -1).transpose(0, 2, 1)
        projections = (basis @ weighted).reshape(b, 3, -1, 3)
        projected = np.einsum("bicj,kji->bck", projections, turned, optimize=True)
        return np.asarray(total - (projected**2).sum(axis=1))

    def shifted(self, seconds: float) -> FloatArray:
        """Return the forces this much later, shape (b, n, 3)."""
        return np.asarray(self.force_at(self.times_s + seconds))

    def keeping(self, keep: BoolArray) -> "Turning":
        """Return some of the parts."""
        return replace(
            self,
            rates=self.rates[keep],
            forces=self.forces[keep],
            weights=self.weights[keep],
            times_s=self.times_s[keep],
        )


def turning_parts(
    accelerometer: Triad, gyroscope: Triad, rests: FloatArray, *, gravity: float
) -> Turning | None:
    """Return the parts of a log that turn; None if there are none.

    `rests` are start and end, shape (m, 2), in s; `gravity` is in the unit of the accelerometer.
    """
    step_s = max(1 / _RATE_HZ, 1 / accelerometer.rate_hz, 1 / gyroscope.rate_hz)
    start = max(accelerometer.offset_s, gyroscope.offset_s)
    end = min(accelerometer.end_s, gyroscope.end_s)
    n = round(_PART_S / step_s)
    steps = math.floor((end - start) / step_s) - 1
    if steps < n or n < 8:
        return None
    times = np.asarray(start + step_s * (np.arange(steps) + 0.5), dtype=np.float64)
    forces, force_times = _means(accelerometer, step_s)
    rates, rate_times = _means(gyroscope, step_s)
    if min(len(forces), len(rates)) < n:
        return None
    force_at = CubicSpline(force_times, forces / gravity)
    firsts = np.arange(0, steps - n + 1, max(1, n // 2))
    index = firsts[:, None] + np.arange(n)
    f = force_at(times)[index]
    complete = _complete(force_times, times, step_s) & _complete(rate_times, times, step_s)
    spread = np.linalg.norm(f.std(axis=1), axis=1) * complete[index].all(axis=1)
    chosen = _apart(spread)
    if not chosen.size:
        return None
    index = index[chosen]
    w = CubicSpline(rate_times, rates - _bias(gyroscope, rests))(times)[index]
    f = f[chosen]
    excess = np.linalg.norm(f, axis=2) - 1
    return Turning(
        rates=w,
        forces=f,
        weights=1 / (1 + (excess / _ACCELERATED) ** 2),
        times_s=times[index],
        step_s=step_s,
        force_at=force_at,
    )


def _apart(spread: FloatArray) -> IntArray:
    """Return the indices of the parts with the largest spread, none of which overlap, in order."""
    chosen: set[int] = set()
    for k in np.argsort(-spread).tolist():
        if spread[k] < _LEAST_SPREAD or len(chosen) == _MOST_PARTS:
            break
        if not {k - 1, k + 1} & chosen:
            chosen.add(k)
    return np.array(sorted(chosen), dtype=np.int64)


def _means(data: Triad, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return running means over a step, shape (n, 3), without missing samples, and their times in s."""
    width = max(1, round(step_s * data.rate_hz))
    # Means every third of a step keep what the spline needs.
    stride = max(1, width // 3)
    total = np.vstack([np.zeros(3), np.cumsum(np.nan_to_num(data.samples), axis=0)])
    known = np.concatenate([[0], np.cumsum(np.isfinite(data.samples).all(axis=1))])
    first = np.arange(0, len(data.samples) - width + 1, stride)
    means = (total[first + width] - total[first]) / width
    whole = known[first + width] - known[first] == width
    times = data.offset_s + (first + (width - 1) / 2) / data.rate_hz
    return means[whole], times[whole]


def _complete(sample_times: FloatArray, times: FloatArray, step_s: float) -> BoolArray:
    """Return at which times there is a sample within two steps on both sides."""
    after = np.clip(np.searchsorted(sample_times, times), 1, sample_times.size - 1)
    return np.asarray(sample_times[after] - sample_times[after - 1] < 2 * step_s)


def _bias(gyroscope: Triad, rests: FloatArray) -> FloatArray:
    spans = gyroscope.places(rests)
    means = [gyroscope.samples[first:end].mean(axis=0) for first, end in spans if end > first]
    # A rest without complete samples has no mean.
    known = [mean for mean in means if np.isfinite(mean).all()]
    return np.median(known, axis=0) if known else np.zeros(3)


def _products(steps: FloatArray) -> FloatArray:
    """Return the products of the first k rotations, shape (b, n, 3, 3), by doubling."""
    product_ = steps.copy()
    length = 1
    while length < product_.shape[1]:
        product_[:, length:] = product_[:, length:] @ product_[:, :-length]
        length *= 2
    return product_


def _crosses(vectors: FloatArray) -> FloatArray:
    """Return the matrices of the cross products with vectors, shape (..., 3) to (..., 3, 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    o = np.zeros_like(x)
    flat = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1)
    return flat.reshape(*vectors.shape, 3)

"""Exact errors of a Kalman filter of an angle and a gyroscope's bias, for any true noise.

The filter's model is white noise N and a random walk K of the bias. Each second it adds the gyroscope's
increment minus its bias; while it is aided, it measures the angle with white noise. Then it coasts. The
estimate is a weighted sum of the inputs, with weights that only depend on N, K and the aiding. The variance
of its error is therefore a quadratic form of the weights and the true noise's second sums, for any noise of
stationary increments. The true bias is arbitrary, because the weights on the increments add up to 0.

NEES, the normalised estimation error squared, is the true variance divided by the filter's predicted
variance: 1 for a filter with the true model, above 1 for an overconfident one.

Source: Bar-Shalom, Li & Kirubarajan (2001), Estimation with Applications to Tracking and Navigation,
sec. 5.4 (NEES); the weights are the filter's own equations, run backward.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imucal.arrays import FloatArray
from imucal.noise.model import NoiseModel

__all__ = ["COASTS_S", "Aiding", "Weights", "errors", "nees", "quadratic_form", "weights"]

#: Durations of coasting after the last angle, in s; 0 is the aided filter.
COASTS_S = (0, 1, 10, 60, 300, 1000)
#: Initial deviation of the bias relative to N: so large that it is uninformative.
_DIFFUSE = 1e4


class Aiding(NamedTuple):
    """Aiding of the filter: `updates` angles, one per second, with deviation `sd`."""

    sd: float = 2e-3
    updates: int = 1000


class Weights(NamedTuple):
    """Weights of the inputs in the filter's estimates, for p pairs (N, K).

    Attributes
    ----------
    predicted
        The filter's predicted variance of the angle after each coast, shape (p, c), in U² s².
    increments
        Weights of the aided seconds' increments in the angle and in the bias, shape (2, p, updates).
    angles
        Weights of the measured angles in both, shape (2, p, updates + 1); the first angle starts the filter.
    """

    predicted: FloatArray
    increments: FloatArray
    angles: FloatArray


def weights(pairs: FloatArray, aiding: Aiding, coasts_s: Sequence[int] = COASTS_S) -> Weights:
    """Return predicted variances and weights of the filters of `pairs`, shape (p, 2): N and K."""
    N, K = np.asarray(pairs, dtype=np.float64).T
    noise = aiding.sd**2
    gains = np.empty((aiding.updates, 2, N.size))
    # Variance of the angle, covariance, variance of the bias. The first angle is measured, the bias unknown.
    angle, both, bias = np.full(N.size, noise), np.zeros(N.size), (_DIFFUSE * np.maximum(N, K)) ** 2
    for gain in gains:
        angle, both, bias = angle - 2 * both + bias + N**2 + K**2 / 3, both - bias - K**2 / 2, bias + K**2
        gain[:] = angle / (angle + noise), both / (angle + noise)
        angle, both, bias = angle * (1 - gain[0]), both * (1 - gain[0]), bias - gain[1] * both
    predicted = [angle - 2 * h * both + h**2 * bias + N**2 * h + K**2 * h**3 / 3 for h in coasts_s]
    # Backward recursion: dependence of the final angle and bias on those after each second.
    of_angle, of_bias = np.eye(2)[:, :, None] * np.ones(N.size)
    increments = np.empty((2, N.size, aiding.updates))
    angles = np.empty((2, N.size, aiding.updates + 1))
    for k in range(aiding.updates - 1, -1, -1):
        angles[:, :, k + 1] = of_angle * gains[k, 0] + of_bias * gains[k, 1]
        of_angle = of_angle - angles[:, :, k + 1]
        increments[:, :, k] = of_angle
        of_bias = of_bias - of_angle
    angles[:, :, 0] = of_angle
    return Weights(np.stack(predicted, axis=1), increments, angles)


def coasting(found: Weights, coast_s: int) -> tuple[FloatArray, FloatArray]:
    """Return the weights on all increments, shape (p, updates + coast), and the power of those on angles.

    The weights on the increments add up to 0 in each row, so a constant bias has no effect.
    """
    aided = found.increments[0] - coast_s * found.increments[1]
    row = np.concatenate([aided, np.ones((len(aided), coast_s))], axis=1)
    on_angles = found.angles[0] - coast_s * found.angles[1]
    return row - row.mean(axis=1, keepdims=True), np.square(on_angles).sum(axis=1)


def quadratic_form(rows: FloatArray, model: NoiseModel, rate_hz: float) -> FloatArray:
    """Return the variances, shape (p,), of one-second increments of `model` summed with weights (p, n).

    The increments are sums of samples at `rate_hz` divided by that rate. The product with the Toeplitz matrix
    of their second sums uses Fourier transforms.
    """
    n = rows.shape[1]
    V = model.sum_variance(np.arange(n + 2.0) * rate_hz, rate_hz=rate_hz) / rate_hz**2
    covariance = np.concatenate([V[1:2], (V[2:] - 2 * V[1:-1] + V[:-2])[: n - 1] / 2])
    length = 1 << (2 * n).bit_length()
    circulant = np.concatenate([covariance, np.zeros(length - 2 * n + 1), covariance[:0:-1]])
    power = np.abs(np.fft.rfft(rows, length)) ** 2 * np.fft.rfft(circulant).real
    total: FloatArray = (power[:, 0] + 2 * power[:, 1:-1].sum(axis=1) + power[:, -1]) / length
    return total


def errors(
    pairs: FloatArray,
    model: NoiseModel,
    *,
    rate_hz: float,
    aiding: Aiding | None = None,
    coasts_s: Sequence[int] = COASTS_S,
) -> tuple[FloatArray, FloatArray]:
    """Return the filters' predicted and true variances after each coast, shapes (p, c), in U² s².

    Parameters
    ----------
    pairs
        N and K of each filter, shape (p, 2).
    model, rate_hz
        The true noise of samples at that rate, a whole number in Hz.
    aiding
        By default an angle of 2 mrad each second for 1000 s.
    coasts_s
        Whole seconds.
    """
    aiding = aiding or Aiding()
    found = weights(pairs, aiding, coasts_s)
    true = []
    for coast in coasts_s:
        row, on_angles = coasting(found, coast)
        true.append(quadratic_form(row, model, rate_hz) + aiding.sd**2 * on_angles)
    return found.predicted, np.stack(true, axis=1)


def nees(
    pairs: FloatArray,
    model: NoiseModel,
    *,
    rate_hz: float,
    aiding: Aiding | None = None,
    coasts_s: Sequence[int] = COASTS_S,
) -> FloatArray:
    """Return true over predicted variance, shape (p, c); see `errors`."""
    predicted, true = errors(pairs, model, rate_hz=rate_hz, aiding=aiding, coasts_s=coasts_s)
    return true / predicted

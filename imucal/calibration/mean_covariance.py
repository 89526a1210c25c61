"""Covariance of the means of several spans of one log, for any noise model."""

import math

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.noise import TERMS, NoiseModel

__all__ = ["mean_covariance", "white_model"]


def mean_covariance(
    model: NoiseModel, spans: IntArray, *, rate_hz: float, samples: int | None = None
) -> FloatArray:
    """Return the covariance of span means minus the mean over the whole log, shape (m, m), in U².

    The generalised variance V(n) of the sum of n samples gives the covariance of two sums up to terms that
    cancel in any contrast. `spans`, shape (m, 2), are first sample and end of each. Spans that are empty or
    outside the log of `samples` raise a ValueError.
    """
    spans = np.asarray(spans, dtype=np.int64).reshape(-1, 2)
    log = (int(spans[:, 0].min()), int(spans[:, 1].max())) if samples is None else (0, samples)
    if np.any(spans[:, 1] <= spans[:, 0]) or spans.min() < log[0] or spans.max() > log[1]:
        raise ValueError(f"spans must be non-empty parts of the log's samples {log}, got {spans.tolist()}")
    first, end = np.vstack([spans, log]).T
    lags = (
        end[None] - first[:, None],
        first[None] - first[:, None],
        end[None] - end[:, None],
        first[None] - end[:, None],
    )
    # Rests of equal length share most lags, and V is even.
    unique, place = np.unique(np.abs(np.stack(lags)), return_inverse=True)
    V = model.sum_variance(unique.astype(np.float64), rate_hz=rate_hz)[place].reshape(
        4, first.size, first.size
    )
    n = (end - first).astype(np.float64)
    c = (V[0] - V[1] - V[2] + V[3]) / (2 * n[:, None] * n)
    K = c[:-1, :-1] - c[:-1, -1:] - c[-1:, :-1] + c[-1, -1]
    return np.asarray((K + K.T) / 2)


def white_model(deviation: float, rate_hz: float) -> NoiseModel:
    """Return white noise whose samples have this standard deviation, in U."""
    return NoiseModel(terms=(TERMS["N"].of(float(deviation) / math.sqrt(rate_hz)),))

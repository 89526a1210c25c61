"""Covariance of the means of several spans of one log, for any noise model."""

import math
from functools import lru_cache

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.noise import TERMS, NoiseModel, NoiseTerm

__all__ = ["mean_covariance", "white_model"]

#: Symbol of the term whose mean over the log is not part of the bias.
_WHITE = "N"


def mean_covariance(
    model: NoiseModel, spans: IntArray, *, rate_hz: float, samples: int | None = None
) -> FloatArray:
    """Return the covariance of span means minus the bias over the whole log, shape (m, m), in U².

    The bias over the log includes the mean of its slow noise (B, K, GM), but not of its white noise, which
    belongs to the samples. The generalised variance V(n) of the sum of n samples gives the covariance of two
    sums up to terms that cancel in any contrast. `spans`, shape (m, 2), are first sample and end of each.
    Spans that are empty or outside the log of `samples` raise a ValueError.
    """
    spans = np.asarray(spans, dtype=np.int64).reshape(-1, 2)
    log = (int(spans[:, 0].min()), int(spans[:, 1].max())) if samples is None else (0, samples)
    if np.any(spans[:, 1] <= spans[:, 0]) or spans.min() < log[0] or spans.max() > log[1]:
        raise ValueError(f"spans must be non-empty parts of the log's samples {log}, got {spans.tolist()}")
    first, end = np.vstack([spans, log]).T
    unique, place = _distinct_lags(first.tobytes(), end.tobytes())
    n = (end - first).astype(np.float64)

    def sum_covariance(terms: list[NoiseTerm]) -> FloatArray:
        if not terms:
            return np.zeros((first.size, first.size))
        variance = NoiseModel(terms=tuple(terms)).sum_variance(unique.astype(np.float64), rate_hz=rate_hz)
        V = variance[place].reshape(4, first.size, first.size)
        return np.asarray((V[0] - V[1] - V[2] + V[3]) / (2 * n[:, None] * n))

    slow = sum_covariance([term for term in model.terms if term.symbol != _WHITE])
    white = sum_covariance([term for term in model.terms if term.symbol == _WHITE])
    K = slow[:-1, :-1] - slow[:-1, -1:] - slow[-1:, :-1] + slow[-1, -1] + white[:-1, :-1]
    return np.asarray((K + K.T) / 2)


@lru_cache(maxsize=16)
def _distinct_lags(firsts: bytes, ends: bytes) -> tuple[IntArray, IntArray]:
    """Return the distinct lags between the ends of all spans, and the place of each lag among them.

    Rests of equal length share most lags, and V is even. A fit asks for the same spans at each step.
    """
    first, end = (np.frombuffer(edge, dtype=np.int64) for edge in (firsts, ends))
    lags = (
        end[None] - first[:, None],
        first[None] - first[:, None],
        end[None] - end[:, None],
        first[None] - end[:, None],
    )
    unique, place = np.unique(np.abs(np.stack(lags)), return_inverse=True)
    return unique, place


def white_model(deviation: float, rate_hz: float) -> NoiseModel:
    """Return white noise whose samples have this standard deviation, in U."""
    return NoiseModel(terms=(TERMS["N"].of(float(deviation) / math.sqrt(rate_hz)),))

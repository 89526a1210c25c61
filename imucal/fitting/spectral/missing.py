"""Scattered missing samples: what the observed ones say about the squared ordinates.

Expectation-maximisation without a model: given a smooth spectrum S, the missing samples given the
observed ones are normal, with precision the missing block of C' diag(1/S) C (C the DCT). Their mean
is found by conjugate gradients, their covariance by a draw, and

    E[X_k² | observed] = (mean X_k)² + var X_k

replaces X_k². The share of the variance in it is information that the gaps took.

Source: Dempster, Laird & Rubin (1977), JRSS B 39; draws: Papandreou & Yuille (2010), NIPS 23;
lost information: Louis (1982), JRSS B 44.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imucal.allan.dct import DctBins
from imucal.allan.four_step import dct2, idct2
from imucal.arrays import BoolArray, FloatArray, IntArray

_ROUNDS = 3
_STEPS = 40
_CLOSE = 1e-3
#: More missing samples, or so many more sines than samples, take longer than transforms do.
_FEW, _DIRECT = 1000, 30
#: The random draws are the same for the same length, so that a fit can be repeated.
_SEED = 20_24


def complete(
    samples: FloatArray, seen: BoolArray, bins: DctBins
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return expected ordinates, the variance of each, what the gaps took, and a draw of what they miss.

    Parameters
    ----------
    samples
        Shape (n,), the values at missing places are ignored; overwritten.
    seen
        Which samples were observed, shape (n,).

    Returns
    -------
    ordinates, variance
        Shapes (n-1,).
    loss
        Share of each bin's information that the gaps took, shape (b,), from 0 to 1.
    drawn
        The missing samples in order, their expectation and an error drawn with it, shape (g,).
    """
    n = samples.size
    gaps = np.flatnonzero(~seen)
    samples[gaps] = _between(samples, gaps)
    mean = float(samples.mean())
    samples -= mean
    groups = _groups(bins)
    pairs = _Pairs.of(gaps, n, groups)
    # Ordinates 0 … n-1; long arrays are written over, or let go as soon as they are not needed.
    mean_of, error_of = dct2(samples), np.broadcast_to(0.0, n)
    for _ in range(_ROUNDS):
        spectrum = _means(mean_of[1:], error_of[1:], groups)
        del error_of
        # The transform of the samples is there already, and that of the draw is the draw.
        right = idct2(_weighed(mean_of, 1 / spectrum, groups))[gaps]
        del mean_of
        draw = np.empty(n)
        np.random.default_rng(_SEED).standard_normal(out=draw[1:])
        drawn = idct2(_weighed(draw, 1 / np.sqrt(spectrum), groups))[gaps]
        del draw
        apply = _precision(gaps, pairs, 1 / spectrum, groups, n)
        unit = _upper_median(spectrum, groups, n)
        samples[gaps] -= _conjugate(apply, right, unit)
        error = _conjugate(apply, drawn, unit)
        error_of = dct2(_padded(error, gaps, n))
        np.square(error_of, out=error_of)
        mean_of = dct2(samples)
    ordinates, variance = mean_of[1:], error_of[1:]
    count = np.diff(groups, append=n - 1)
    share = np.add.reduceat(variance, groups) / (_means(ordinates, variance, groups) * count)
    loss = share[np.searchsorted(groups, bins.first - 1, side="right") - 1]
    return ordinates, variance, np.clip(loss, 0.0, 0.99), mean + samples[gaps] + error


def _between(samples: FloatArray, gaps: IntArray) -> FloatArray:
    """Return what straight lines over each gap give at its places, shape (g,); at an end the neighbour."""
    begins = np.diff(gaps, prepend=-2) > 1
    gap = np.cumsum(begins) - 1
    before, after = gaps[begins] - 1, gaps[np.append(begins[1:], True)[: gaps.size]] + 1
    left = samples[np.where(before < 0, after, before)]
    right = samples[np.where(after >= samples.size, before, after)]
    fraction = (gaps - before[gap]) / (after - before)[gap]
    return np.asarray(left[gap] + fraction * (right - left)[gap])


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Distances between missing samples: `lag`, shape (l,), and which of them |i-j| and i+j+1 are, (g, g)."""

    lag: IntArray
    apart: IntArray
    beyond: IntArray

    @classmethod
    def of(cls, gaps: IntArray, n: int, groups: IntArray) -> "_Pairs | None":
        """Return the distances; None where they are so many that transforms are quicker."""
        if gaps.size > _FEW:
            return None
        apart, beyond = np.abs(gaps[:, np.newaxis] - gaps), gaps[:, np.newaxis] + gaps + 1
        lag, which = np.unique(np.stack([apart, beyond]), return_inverse=True)
        if lag.size * groups.size > _DIRECT * n:
            return None
        which = which.reshape(2, *apart.shape)
        return cls(lag, which[0], which[1])


def _precision(
    gaps: IntArray, pairs: _Pairs | None, weight: FloatArray, groups: IntArray, n: int
) -> Callable[[FloatArray], FloatArray]:
    """Return what multiplies by the missing block of C' diag(w) C, w the weight of each group.

    Its element i, j is r(i-j) + r(i+j+1) with r(l) = sum over k of w_k cos(pi k l / n) / n.
    """
    if pairs is not None:
        of_lag = _cosine_sums(pairs.lag, weight, groups, n)
        matrix = of_lag[pairs.apart] + of_lag[pairs.beyond]
        return lambda values: np.asarray(matrix @ values)

    def by_transforms(values: FloatArray) -> FloatArray:
        result: FloatArray = idct2(_weighed(dct2(_padded(values, gaps, n)), weight, groups))[gaps]
        return result

    return by_transforms


def _cosine_sums(lag: IntArray, weight: FloatArray, groups: IntArray, n: int) -> FloatArray:
    """Return the sum over k = 1 … n-1 of w_k cos(pi k l / n) / n at each lag, shape (l,).

    Of equal weights from a to before b it is w (sin((b - 1/2) t) - sin((a - 1/2) t)) / (2 sin(t/2)).
    """
    edge = np.append(groups, n - 1) + 0.5
    fall = -np.diff(weight, prepend=0.0, append=0.0)
    sums = np.full(lag.size, float(weight @ np.diff(edge)))
    # Lags 0 and 2n are the same, and have no sine.
    for at in np.flatnonzero(lag % (2 * n)).tolist():
        angle = np.pi * int(lag[at]) / n
        sums[at] = float(fall @ np.sin(edge * angle)) / (2 * np.sin(angle / 2))
    return sums / n


def _padded(values: FloatArray, gaps: IntArray, n: int) -> FloatArray:
    """Return values at missing places and 0 elsewhere, shape (n,)."""
    padded = np.zeros(n)
    padded[gaps] = values
    return padded


def _weighed(ordinates: FloatArray, weight: FloatArray, groups: IntArray) -> FloatArray:
    """Multiply ordinates 0 … n-1 in place by the weight of their group, that of 0 being 0; return them."""
    ordinates[0] = 0.0
    for (start, stop), factor in zip(_spans(ordinates.size - 1, groups), weight.tolist(), strict=True):
        ordinates[start + 1 : stop + 1] *= factor
    return ordinates


def _means(ordinates: FloatArray, variance: FloatArray, groups: IntArray) -> FloatArray:
    """Return the mean of square and variance in each group, more than 0, shape of `groups`."""
    means = [
        float(np.mean(np.square(ordinates[start:stop]) + variance[start:stop]))
        for start, stop in _spans(ordinates.size, groups)
    ]
    return np.maximum(means, 1e-300)


def _upper_median(spectrum: FloatArray, groups: IntArray, n: int) -> float:
    """Return the median over the upper half of the ordinates."""
    half = (n - 1) // 2
    ends = np.maximum(np.append(groups, n - 1), half)
    return float(np.median(np.repeat(spectrum, np.diff(ends))))


def _spans(n: int, groups: IntArray) -> list[tuple[int, int]]:
    """Return the first and the last index of each group, the last beyond it."""
    return list(pairwise([*groups.tolist(), n]))


def _groups(bins: DctBins) -> IntArray:
    """Return the first index of each group of neighbouring bins of 16 ordinates or more."""
    starts = bins.first - 1
    chosen = [0]
    for start in starts[1:].tolist():
        if start - chosen[-1] >= 16 and bins.n - 1 - start >= 16:
            chosen.append(start)
    return np.array(chosen, dtype=np.int64)


def _conjugate(apply: Callable[[FloatArray], FloatArray], right: FloatArray, unit: float) -> FloatArray:
    """Solve ``apply(x) = right`` by conjugate gradients, to a small part of the samples' noise."""
    x = np.zeros(right.size)
    rest = right.copy()
    direction = rest.copy()
    size = rest @ rest
    goal = _CLOSE**2 * max(float(size), right.size / unit)
    for _ in range(_STEPS):
        if size <= goal:
            break
        image = apply(direction)
        step = size / (direction @ image)
        x += step * direction
        rest -= step * image
        previous, size = size, rest @ rest
        direction = rest + size / previous * direction
    return x

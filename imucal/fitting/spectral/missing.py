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

import numpy as np

from imucal.allan.dct import DctBins
from imucal.arrays import BoolArray, FloatArray, IntArray

_ROUNDS = 3
_STEPS = 40
_CLOSE = 1e-3
#: The random draws are the same for the same length, so that a fit can be repeated.
_SEED = 20_24


def complete(
    samples: FloatArray, seen: BoolArray, bins: DctBins
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return expected ordinates, the variance of each, what the gaps took, and a draw of what they miss.

    Parameters
    ----------
    samples
        Shape (n,), the values at missing places are ignored.
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
    from scipy.fft import dct, idct

    n = samples.size
    places = np.arange(n)
    filled = np.where(seen, samples, np.interp(places, places[seen], samples[seen]))
    mean = filled.mean()
    filled -= mean
    gaps = np.flatnonzero(~seen)
    draw = np.random.default_rng(_SEED).standard_normal(n - 1)
    groups = _groups(bins)
    variance, error = np.zeros(n - 1), np.zeros(n)
    ordinates = dct(filled, norm="ortho")[1:]
    for _ in range(_ROUNDS):
        spectrum = _smooth(ordinates**2 + variance, groups)
        weight = np.concatenate([[0.0], 1 / spectrum])

        def precision(values: FloatArray, weight: FloatArray = weight) -> FloatArray:
            result: FloatArray = idct(weight * dct(values, norm="ortho"), norm="ortho")
            return result

        def missing(values: FloatArray, apply: Callable[[FloatArray], FloatArray] = precision) -> FloatArray:
            padded = np.zeros(n)
            padded[gaps] = values
            return apply(padded)[gaps]

        unit = float(np.median(spectrum[spectrum.size // 2 :]))
        filled[gaps] -= _conjugate(missing, precision(filled)[gaps], unit)
        other = idct(np.concatenate([[0.0], np.sqrt(spectrum) * draw]), norm="ortho")
        error[gaps] = _conjugate(missing, precision(other)[gaps], unit)
        ordinates = dct(filled, norm="ortho")[1:]
        variance = dct(error, norm="ortho")[1:] ** 2
    whole = ordinates**2 + variance
    share = np.add.reduceat(variance, groups) / np.add.reduceat(whole, groups)
    loss = share[np.searchsorted(groups, bins.first - 1, side="right") - 1]
    return ordinates, variance, np.clip(loss, 0.0, 0.99), mean + filled[gaps] + error[gaps]


def _groups(bins: DctBins) -> IntArray:
    """Return the first index of each group of neighbouring bins of 16 ordinates or more."""
    starts = bins.first - 1
    chosen = [0]
    for start in starts[1:].tolist():
        if start - chosen[-1] >= 16 and bins.n - 1 - start >= 16:
            chosen.append(start)
    return np.array(chosen, dtype=np.int64)


def _smooth(square: FloatArray, groups: IntArray) -> FloatArray:
    """Return the mean of the squares in each group, spread over its ordinates."""
    count = np.diff(groups, append=square.size)
    return np.repeat(np.maximum(np.add.reduceat(square, groups) / count, 1e-300), count)


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

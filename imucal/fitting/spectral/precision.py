"""Precision of each coefficient that a record of a given length allows: the numerical Cramér-Rao bound.

The squared DCT ordinates of a record are independent with the expectation S(theta), so the information on
variance parameters is half the sum of d ln S d ln S' over all ordinates. The information on the ramp is the
sum of its squared ordinates over S.

Source: Whittle (1953).
"""

import math
from collections.abc import Iterable

import numpy as np

from imucal.allan.dct import dct_bins
from imucal.arrays import FloatArray
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS, RateRamp, term_keys


def named_terms(model: NoiseModel) -> tuple[tuple[NoiseTerm, tuple[str, ...]], ...]:
    """Return each term with its parameters' names: ``N``, ``GM.sigma``, ``GM.T``; ``GM1``… by rising T."""
    ordered = sorted(model.terms, key=lambda term: term.values[1:])
    keys = dict(zip(map(id, ordered), term_keys(term.symbol for term in ordered), strict=True))
    return tuple((term, term.parameter_names(keys[id(term)])) for term in model.terms)


def relative_deviations(
    model: NoiseModel, *, rate_hz: float, duration_s: float, added: Iterable[str] = ()
) -> dict[str, float]:
    """Return the relative standard error of each parameter that a record of `duration_s` allows.

    The fit also has the `added` power laws, whose coefficients are zero. The result is infinite for a term
    with coefficient 0, and for a record with fewer samples than parameters.
    """
    names = [name for _, own in named_terms(model) for name in own]
    n = round(duration_s * rate_hz)
    # Their size has no effect.
    terms = [*model.terms, *(TERMS[symbol].of(1.0) for symbol in added)]
    if n <= len(names) + len(terms) - len(model.terms) + 1:
        return dict.fromkeys(names, math.inf)
    bins = dct_bins(n, singles=64, per_octave=12)
    count = bins.count.astype(np.float64)
    parts = [term.dct_slopes(bins.n, bins.first, bins.count, 1 / rate_hz) for term in terms]
    spectrum = sum((own for own, _ in parts[: len(model.terms)]), np.zeros(bins.size))
    slopes = np.vstack([own for _, own in parts])
    # A ramp alone has no noise to compare with.
    scaled = slopes / np.where(spectrum > 0, spectrum, math.inf) * np.sqrt(count / 2)
    length = np.sqrt(np.einsum("ij,ij->i", scaled, scaled))
    moving = np.flatnonzero(length > 0)
    result = dict.fromkeys(names, math.inf)
    for place, deviation in zip(moving.tolist(), _deviations(scaled[moving], length[moving]), strict=True):
        if place < len(names):
            result[names[place]] = deviation
    for term in model.terms:
        if isinstance(term, RateRamp) and term.value:
            # A ramp has only odd ordinates; they fall as 1/k².
            half = bins.omega / 2
            squares = 2 / bins.n * np.cos(half) ** 2 / (4 * np.sin(half) ** 4)
            odd = np.where(bins.count == 1, bins.first % 2, bins.count / 2)
            ramp = float(1 / np.sqrt(np.sum(odd * squares / spectrum))) if np.all(spectrum > 0) else 0.0
            result["R"] = ramp * rate_hz / abs(term.value)
    return result


def _deviations(scaled: FloatArray, length: FloatArray) -> list[float]:
    """Return the square roots of the diagonal of (scaled scaled')^-1, inf if rows are collinear."""
    if not scaled.size:
        return []
    # QR: the condition is the square root of the information's.
    factor = np.linalg.qr((scaled / length[:, np.newaxis]).T, mode="r")
    if np.abs(np.diag(factor)).min() < 1e-12:
        return [math.inf] * length.size
    inverse = np.linalg.inv(factor)
    return [float(d) for d in np.sqrt(np.einsum("ij,ij->i", inverse, inverse)) / length]

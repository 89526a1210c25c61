"""What share of each Allan variance is the noise of the model: the rest is filter, lines, and vibration.

The likelihood takes an output filter into the fit, and leaves lines and what lies above its band out;
the Allan curve holds them all. With H the response of the Allan variance, the share is

    sum H S_model / (sum H S_seen + lines),

S_seen the model behind its filter, and above the band what was measured there. Errors of the sums over
bins are in both and cancel.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucal.allan.confidence import power_response
from imucal.allan.dct import DctBins
from imucal.allan.estimators import ESTIMATORS
from imucal.arrays import FloatArray, IntArray
from imucal.fitting.noise_fit import Line
from imucal.fitting.spectral.estimates import Fitted
from imucal.fitting.spectral.filter_response import Band
from imucal.fitting.spectral.likelihood import evaluate
from imucal.fitting.spectral.ordinates import Ordinates


def noise_share(
    whole: Ordinates,
    bins: DctBins,
    fitted: Fitted,
    band: Band,
    lines: Sequence[Line],
    *,
    m: IntArray,
    rate_hz: float,
) -> FloatArray:
    """Return the share of the Allan variance at each of the averaging factors `m`, shape (k,).

    Parameters
    ----------
    whole
        Ordinates of the whole band, one block's, in `bins`.
    fitted
        The fit of the part of them up to ``band.fraction``.
    lines
        What was left out; amplitudes in the samples' unit.

    Notes
    -----
    A line of amplitude A at f adds A² sin⁴(pi f m tau0) / (m sin(pi f tau0))².
    """
    model, seen = _spectra(whole, fitted, band)
    count = bins.count.astype(np.float64)
    share = np.empty(m.size)
    for i, factor in enumerate(m.tolist()):
        response, _ = power_response(bins, factor, ESTIMATORS["overlapping"])
        noise = float((count * response) @ model)
        held = float((count * response) @ seen) + bins.n * _of_lines(lines, factor, whole.scale, rate_hz)
        share[i] = noise / held if held > 0 else 1.0
    return share


def _spectra(whole: Ordinates, fitted: Fitted, band: Band) -> tuple[FloatArray, FloatArray]:
    """Return the model's spectrum in every bin, and that which the curve holds; shape (b,) each."""
    theta = fitted.maximum.theta
    none = np.zeros(1, dtype=np.int64)
    model = evaluate(whole, replace(fitted.candidate, poles=none, zeros=none), theta).spectrum[0]
    inside = whole.fraction <= band.fraction * (1 + 1e-9)
    top = 4 * float(np.sin(np.pi / 2 * band.fraction)) ** 2
    part = replace(whole.take(inside), top=top)
    measured = np.where(whole.size > 0, whole.power / np.maximum(whole.size, 1e-12), model)
    seen = np.where(inside, model, measured)
    seen[inside] = evaluate(part, fitted.candidate, theta).spectrum[0]
    return model, seen


def _of_lines(lines: Sequence[Line], m: int, scale: float, rate_hz: float) -> float:
    """Return what lines add to the Allan variance, over `scale` squared."""
    total = 0.0
    for line in lines:
        half = np.pi * line.frequency_hz / rate_hz
        total += (line.amplitude / scale) ** 2 * np.sin(half * m) ** 4 / (m * np.sin(half)) ** 2
    return float(total)

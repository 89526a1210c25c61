"""The output filter that a fit found, in words and figures."""

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Response
from imucal.fitting.spectral.band import Band
from imucal.fitting.spectral.estimates import Fitted
from imucal.fitting.spectral.ordinates import MARKOV, Ordinates

_NUMBER = ("no", "one", "two", "three", "four", "five")
#: Largest difference of |H|² from a Butterworth filter's that is called one.
_ALIKE = 0.02


def response_of(ordinates: Ordinates, fitted: Fitted, band: Band, rate_hz: float) -> Response | None:
    """Return the filter's kind and -3 dB corner, or None where it has none inside the band."""
    if not band.order[0]:
        return None
    frequency = np.linspace(0.0, band.fraction, 2001)[1:]
    power = _power(ordinates, fitted, frequency)
    below = np.flatnonzero(power < 0.5)
    if not below.size:
        return None
    corner = float(frequency[below[0]])
    return Response(kind=_kind(band, frequency, power, corner), cutoff_hz=corner * rate_hz / 2)


def _power(ordinates: Ordinates, fitted: Fitted, frequency: FloatArray) -> FloatArray:
    """Return |H|² at fractions of Nyquist."""
    lam = 4 * np.sin(np.pi / 2 * frequency) ** 2
    poles, zeros = int(fitted.candidate.poles[0]), int(fitted.candidate.zeros[0])
    first = MARKOV + 2 * fitted.candidate.room_markov
    response = fitted.maximum.theta[0, first : first + poles]
    denominator = 1 + (lam[:, None] / ordinates.top) ** np.arange(1, poles + 1) @ response
    power: FloatArray = (1 - lam / 4) ** zeros / denominator
    return power


def _kind(band: Band, frequency: FloatArray, power: FloatArray, corner: float) -> str:
    """Return the name of the family, such as ``one-pole``, ``butterworth-2`` or ``three-pole``."""
    poles, zeros = band.order
    used = frequency < 0.98
    if zeros == poles:
        ratio = np.tan(np.pi / 2 * frequency[used]) / np.tan(np.pi / 2 * corner)
        if np.max(np.abs(power[used] - 1 / (1 + ratio ** (2 * poles)))) < _ALIKE:
            return f"butterworth-{poles}"
    name = f"{_NUMBER[poles]}-pole"
    return name if not zeros else f"{name} {_NUMBER[zeros]}-zero"


def filter_finding(
    ordinates: Ordinates, fitted: Fitted, band: Band, response: Response | None, *, rate_hz: float, axis: str
) -> tuple[Finding, ...]:
    """Return what is said about an output filter; nothing where the whole band is flat."""
    top = band.fraction * rate_hz / 2
    if band.poles == 0 and band.fraction == 1.0:
        return ()
    if response is not None:
        text = (
            f"An output filter ({response.kind}, -3 dB at {response.cutoff_hz:.4g} Hz) shapes the spectrum; "
            f"its response is fitted with the noise up to {top:.4g} Hz."
        )
    elif band.order[0]:
        change = 10 * float(np.log10(_power(ordinates, fitted, np.array([band.fraction]))[0]))
        why = "a resonance or a vibration" if change > 0 else "an output filter"
        text = (
            f"The spectrum is not flat where its noise is white ({change:+.1f} dB at {top:.4g} Hz: {why}); "
            f"a response is fitted with the noise up to {top:.4g} Hz."
        )
    else:
        text = (
            f"Above {top:.4g} Hz an output filter, or a vibration, shapes the spectrum; "
            "the fit uses what is below."
        )
    return (
        Finding(
            level="info",
            code="output-filter",
            axis=axis,
            text=text,
            advice="The model is that of the noise before the filter, right at times beyond the filter's.",
        ),
    )

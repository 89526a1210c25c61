"""The part of the spectrum to fit, and the bend of an output filter in it.

A bend multiplies the spectrum of the noise:

    |H|² = 1 / (1 + a_1 x + … + a_j x^j),   x = lam / top,  lam = 4 sin²(theta/2),

with `top` at the upper edge of the band. The gain at zero frequency is 1, so that N keeps its meaning.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Response
from imucal.fitting.spectral.disturbances.hump import Hump, hump_finding
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.models import COLUMN, SHORTEST
from imucal.fitting.spectral.ordinates import Ordinates, band_top

#: Number of bins that show the highest frequencies of the band.
_HIGHEST = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """The part of the spectrum to fit, up to a `fraction` of Nyquist, and its bend.

    `response` has the curvature coefficients, shape (j,), to start from. Correlation times are at least
    `shortest` samples. `masked` is the correlation time, in samples, of a term that could explain the
    spectrum instead of a filter, or 0. `rise` is the density above the edge relative to the noise, or 0 if it
    does not rise. `corner` is the -3 dB corner of a filter, as a fraction of Nyquist. The bins of a `hump`
    are excluded. `statistic` is the misfit score of the search.
    """

    fraction: float = 1.0
    response: FloatArray = field(default_factory=lambda: np.zeros(0))
    shortest: float = SHORTEST
    masked: float = 0.0
    rise: float = 0.0
    corner: float | None = None
    hump: Hump | None = None
    statistic: float = 0.0

    @property
    def poles(self) -> int:
        """Number of curvature coefficients, j."""
        return self.response.size

    @property
    def flat(self) -> bool:
        """Whether it is the whole spectrum without a bend or hump."""
        return self.poles == 0 and self.fraction == 1.0 and self.hump is None

    def holds(self, ordinates: Ordinates) -> BoolArray:
        fraction = ordinates.fraction
        inside = fraction <= self.fraction * (1 + 1e-9)
        if self.hump:
            inside &= self.hump.outside(fraction)
        return inside

    def select(self, ordinates: Ordinates) -> Ordinates:
        """Return the bins of the band that are not empty."""
        return replace(ordinates[self.holds(ordinates) & (ordinates.size > 0)], top=band_top(self.fraction))


def response_of(band: Band, rate_hz: float) -> Response | None:
    """Return the output filter, or None if no corner was found."""
    return Response(cutoff_hz=band.corner * rate_hz / 2) if band.corner is not None else None


def filter_finding(
    fitted: Fits, band: Band, response: Response | None, *, rate_hz: float, axis: str
) -> tuple[Finding, ...]:
    """Return the finding about a narrower band, a bend or a hump."""
    top = band.fraction * rate_hz / 2
    if band.flat and not band.masked:
        return ()
    if band.hump:
        return (hump_finding(band.hump, rate_hz=rate_hz, axis=axis, fitted=True),)
    if band.masked:
        return (_two_readings(fitted, band, response, rate_hz=rate_hz, axis=axis),)
    if band.rise:
        text = (
            f"The density above {top:.3g} Hz rises to {band.rise:.3g} times the noise below: a vibration, a "
            "sway or a resonance. The fit uses the frequencies below; the Allan curve contains all."
        )
        advice = "Record on a firm surface, away from motors, fans and footsteps."
        return (Finding("warning", "hump", text, advice, axis=axis),)
    if response is not None:
        text = (
            f"An output filter (-3 dB at {response.cutoff_hz:.4g} Hz) shapes the spectrum; its response is "
            f"fitted with the noise up to {top:.4g} Hz."
        )
    elif band.fraction == 1.0:
        text = "The spectrum falls at its top: an output filter bends it. The bend is fitted with the noise."
    else:
        text = f"A filter or a vibration shapes the spectrum above {top:.4g} Hz; the fit uses the rest."
    advice = "The model describes the noise before the filter, at times longer than the filter's."
    return (Finding("info", "output-filter", text, advice, axis=axis),)


def _two_readings(
    fitted: Fits, band: Band, response: Response | None, *, rate_hz: float, axis: str
) -> Finding:
    of_filter, time_s = "", band.masked / rate_hz
    if response:
        of_filter = f" (-3 dB at {response.cutoff_hz:.3g} Hz)"
        time_s = 1 / (2 * np.pi * response.cutoff_hz)
    less = "far less than"
    if band.fraction == 1.0:
        seen = fitted.spectrum[0, -_HIGHEST:].mean()
        below = float(np.sqrt(seen / np.exp(fitted.theta[0, COLUMN["N"]])))
        less = f"less than {below:.2g} times"
    text = (
        f"The spectrum has two explanations: white noise behind a low-pass filter{of_filter}, or a Gauss-"
        f"Markov term of T = {time_s:.3g} s whose white noise is too weak to see. The fit "
        f"assumes the filter. Without one, N would be {less} the reported value."
    )
    advice = (
        "Look for a low-pass filter or smoothing in the sensor's settings and in the driver. Switch it off "
        "and record again, or keep it and use this N."
    )
    return Finding("warning", "output-filter", text, advice, axis=axis)

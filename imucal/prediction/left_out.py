"""Noise that a fit leaves out on purpose, such as a vibration, tones and spikes.

A filter still meets it. The Allan curve contains vibrations and tones, and the fit knows the size of the
spikes that it replaced. So the measured Allan variance, plus that of the spikes, is compared with the
prediction of some numbers.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import NoiseFit
from imucal.noise.term import NoiseTerm

#: Averaging times of the comparison, in s: those of a filter between two updates.
TIMES_S = (1.0, 10.0)
#: Ratio of deviations up to which nothing is reported: most filters are inflated by more.
_NOTICEABLE = 1.1
#: Codes of the findings about what a fit leaves out at these times -> its name.
_CAUSES = {
    "hump": "a vibration",
    "tone": "tones",
    "line": "tones",
    "spikes": "spikes",
    "torn-reads": "torn reads",
    "step": "jumps",
    "cycle": "a cycle",
    "warm-up-fitted": "a warm-up",
    "temperature": "an effect of the temperature",
}


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """How much larger the measured noise of an axis is than that of some numbers.

    Attributes
    ----------
    ratios
        (t, ratio): measured over predicted Allan deviation at t, in s, for the times of `TIMES_S` at which
        the limits of the curve exclude the prediction.
    white
        The factor on the white noise with which the prediction reaches the measured deviation at these times.
    """

    ratios: tuple[tuple[float, float], ...]
    white: float


def left_out(
    fit: NoiseFit,
    white_avar: Callable[[FloatArray], FloatArray],
    slow_avar: Callable[[FloatArray], FloatArray],
    *,
    step_s: float = 0.0,
) -> LeftOut | None:
    """Return how much larger the measured noise is than a prediction; None if it is not clearly larger.

    `white_avar` and `slow_avar` return the two parts of the predicted Allan variance, in U², at times in s.
    Times shorter than `step_s`, between two updates of a filter, do not count. A fit of a model without a
    measured curve leaves out nothing.
    """
    curve = fit.curve
    if curve.computed == "given" or curve.tau.size < 2:
        return None
    spikes = fit.goodness.spikes**2 / (fit.rate_hz * curve.tau)
    lowest = curve.confidence_interval(fit.level)[0] ** 2 + spikes
    measured = curve.avar + spikes
    shortest_s = max(curve.tau[0], step_s)
    times = np.array([time for time in TIMES_S if shortest_s <= time <= curve.tau[-1]])
    white, slow = white_avar(times), slow_avar(times)
    surely = _between(curve.tau, lowest, times) > _NOTICEABLE**2 * (white + slow)
    if not surely.any():
        return None
    times, white, slow = times[surely], white[surely], slow[surely]
    found = _between(curve.tau, measured, times)
    ratios = np.sqrt(found / (white + slow))
    factors = (found - slow) / np.maximum(white, np.finfo(float).tiny)
    return LeftOut(
        ratios=tuple(zip(times.tolist(), ratios.tolist(), strict=True)),
        white=math.sqrt(float(np.max(factors))),
    )


def left_out_of_model(fit: NoiseFit, terms: Sequence[NoiseTerm]) -> LeftOut | None:
    """Return how much larger the measured noise is than the sum of some terms, or None."""

    def of_terms(times: FloatArray, *, white: bool) -> FloatArray:
        m = np.maximum(np.round(times * fit.rate_hz), 1.0)
        parts = [term.avar(m, 1 / fit.rate_hz) for term in terms if (term.symbol == "N") == white]
        return np.asarray(np.sum([np.zeros_like(times), *parts], axis=0))

    return left_out(fit, partial(of_terms, white=True), partial(of_terms, white=False))


def causes(findings: Sequence[Finding]) -> str:
    """Return what the findings of an axis name as left out."""
    codes = {finding.code for finding in findings}
    named = dict.fromkeys(name for code, name in _CAUSES.items() if code in codes)
    return " and ".join(named) or "noise that its model does not describe"


def _between(tau: FloatArray, avar: FloatArray, times: FloatArray) -> FloatArray:
    """Return Allan variances at times between those of the curve, by straight lines of the logarithms."""
    return np.exp(np.interp(np.log(times), np.log(tau), np.log(np.maximum(avar, np.finfo(float).tiny))))

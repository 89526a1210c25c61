"""What an Allan curve can't tell: spectra that differ, with one and the same curve.

With D(tau) = integral of S(f) sin^2(pi f tau)/f^2 df the Allan variance is proportional to
(D(tau) - D(2 tau)/4)/tau^2, and the second part is the first of S(f/2)/2. So S enters by
S(f) - S(f/2)/2 alone, and what obeys Phi(f) = 2 Phi(2f), with nothing over an octave, adds nothing to
the curve at any tau: 1/f times any ripple of one period an octave. Such a pair is told apart by the
spectrum only. So a fit of a curve alone says that nothing has looked at one; where there are samples,
their spectrum is looked at.

Source: Greenhall (1998), "Spectral ambiguity of Allan variance", IEEE Trans. Instrum. Meas. 47, 623.
"""

import math

import numpy as np

from imucal.allan.dct import Spectrum
from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import NoiseFit

#: Misfit score from which a fit says itself that it does not describe the curve.
_MISFIT = 3.0
#: Ordinates that drift and the ends of the record bend, each a bin of its own.
_LOWEST = 8
#: Score of all bins together, standard normal, from which the spectrum contradicts the model.
_CONTRADICTED = 5.0
#: Bins this many standard deviations, and this factor, from the model are what the curve hid; fewer than
#: so many are a line, which the screening names.
_FAR, _NOTABLE, _LEAST_BINS = 3.0, 1.3, 3
#: Of the logarithm of the density: what the estimates' own errors may make.
_TOLERANCE = 0.05


def unseen_spectrum() -> Finding:
    """Return what is to say where there is a curve and no spectrum."""
    return Finding(
        level="info",
        code="spectral-ambiguity",
        text="A curve alone was fitted: spectra that differ by a ripple Phi(f) = 2 Phi(2f) have the same "
        "Allan variance at every averaging time, so nothing has checked that the noise has the model's.",
        advice="Look at the density of the samples beside the curve, or fit the samples themselves by mle.",
    )


def ambiguity_findings(result: NoiseFit, spectrum: Spectrum, axis: str) -> tuple[Finding, ...]:
    """Return a finding where a fit of the curve describes it, but not the spectrum of the samples.

    Looked at are the frequencies that the used averaging times see, without the lowest 8. All together
    must be beyond chance (5 standard deviations), and 3 bins differ by 3 of their own and by 30 %.
    Nothing is said of a fit of the spectrum, nor where the curve is not described either: the fit
    itself says that.
    """
    tau = result.goodness.tau_s
    described = result.goodness.statistic < _MISFIT
    if tau is None or not described or not any(term.psd(np.ones(1), 1.0)[0] for term in result.model.terms):
        return ()
    used = np.arange(spectrum.frequency.size) >= _LOWEST
    used &= spectrum.frequency <= 0.5 / tau[0]
    density = result.model.psd(spectrum.frequency, rate_hz=result.rate_hz)
    used &= _ramp(result, spectrum.frequency) < _TOLERANCE * density
    frequency, count = spectrum.frequency[used], spectrum.count[used]
    ratio = spectrum.psd[used] / density[used]
    score = _score(ratio, count)
    far = (np.abs(score) > _FAR) & (np.abs(np.log(ratio)) > math.log(_NOTABLE))
    together = float(np.sum(score**2 - 1)) / math.sqrt(2 * max(score.size, 1))
    if together < _CONTRADICTED or far.sum() < _LEAST_BINS:
        return ()
    low, high = frequency[far][[0, -1]]
    worst = ratio[far][int(np.argmax(np.abs(np.log(ratio[far]))))]
    factor, side = max(worst, 1 / worst), "above" if worst > 1 else "below"
    text = (
        f"{result.model} describes the Allan curve but not the spectrum: between {low:.3g} and {high:.3g} Hz "
        f"the density is up to {factor:.3g} times {side} the model's. The curve can't tell: spectra that "
        "differ by Phi(f) = 2 Phi(2f) share it."
    )
    advice = "Look at the spectrum and fit the samples themselves by mle; trust no number of this fit."
    return (Finding(level="warning", code="spectral-ambiguity", axis=axis, text=text, advice=advice),)


def _ramp(result: NoiseFit, frequency: FloatArray) -> FloatArray:
    """Return what a ramp in the model, which has no density, leaves at each frequency at most."""
    tau0 = 1 / result.rate_hz
    slope = sum(term.coefficient * tau0 for term in result.model.terms if term.symbol == "R")
    left: FloatArray = tau0 * slope**2 / (2 * result.curve.n * np.sin(np.pi * frequency * tau0) ** 4)
    return left


def _score(ratio: FloatArray, count: FloatArray) -> FloatArray:
    """Return standard-normal scores of chi-squared means over their expectation, less a tolerance.

    Source: Wilson & Hilferty (1931), PNAS 17, 684.
    """
    variance = 2 / (9 * count)
    within = np.clip(ratio, math.exp(-_TOLERANCE), math.exp(_TOLERANCE))
    score: FloatArray = (np.cbrt(ratio / within) - (1 - variance)) / np.sqrt(variance)
    return score

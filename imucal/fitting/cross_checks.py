"""Checks of a fit by other views of the same samples: another fit, the spectrum.

`second_opinion` is Hausman's test of a maximum-likelihood fit against the fit of the Allan curve. If the
model is right, the variance of the difference of both estimates is the difference of their variances, because
the maximum-likelihood fit is efficient.

`ambiguity_findings` reports a wrong spectrum that the Allan curve hides: the curve depends only on
S(f) - S(f/2)/2, so a function Phi(f) = 2 Phi(2f) whose integral over an octave is zero does not change it.

Source: Hausman (1978), "Specification tests in econometrics", Econometrica 46, 1251, eq. (2.7); Greenhall
(1998), "Spectral ambiguity of Allan variance", IEEE Trans. Instrum. Meas. 47, 623.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from imucal.allan import allan_curve
from imucal.allan.dct import Spectrum
from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting.noise_fit import MISFIT, Estimate, NoiseFit
from imucal.fitting.settings import FitSettings
from imucal.noise.terms import TERMS
from imucal.recording import AxisSeries

#: Standard deviations from which a disagreement is reported.
_DISAGREEMENT = 3.0
#: Lower limit of a difference's relative standard deviation.
_MIN_RELATIVE_DEVIATION = 1 / 300
#: Terms of short averaging times, where an output filter changes the curve.
_OF_SHORT_TIMES = {"Q", "N"}
#: Lower limit of the difference's variance, relative to the second fit's.
_MIN_VARIANCE_RATIO = 0.25


def second_opinion(mle: NoiseFit, gmwm: NoiseFit) -> tuple[Finding, ...]:
    """Return a finding for each term on which two fits of one axis disagree.

    Q and N are not compared behind an output filter, which the curve still contains.
    """
    findings = []
    filtered = any(finding.code == "output-filter" for finding in mle.findings)
    for first in mle.estimates:
        if filtered and first.symbol in _OF_SHORT_TIMES:
            continue
        second = next((e for e in gmwm.estimates if e.key == first.key), None)
        if second is None:
            continue
        if _distance(mle, gmwm, first, second) > _DISAGREEMENT:
            values = f"{_value(first)} by {mle.method} and {_value(second)} by {gmwm.method}"
            axis = next((f.axis for f in (*mle.findings, *gmwm.findings) if f.axis), None)
            text = f"{first.key} is {values}: the two disagree, so the model is wrong at some frequencies."
            advice = "Look at the curve and the spectrum. Use neither interval."
            findings.append(Finding("warning", "second-opinion", text, advice, axis=axis))
    return tuple(findings)


def _distance(mle: NoiseFit, gmwm: NoiseFit, first: Estimate, second: Estimate) -> float:
    """Return how far apart two estimates are, in standard deviations."""
    if first.value is None or second.value is None:
        apart = first.low > second.high or second.low > first.high
        return math.inf if apart else 0.0
    # Squared relative standard errors.
    variances = []
    for fit, e, value in ((mle, first, first.value), (gmwm, second, second.value)):
        name = TERMS[e.symbol].parameter_names(e.key)[0]
        if name not in fit.parameters or not value:
            return 0.0
        place = fit.parameters.index(name)
        variances.append(float(fit.covariance[place, place]) / value**2)
    if not all(map(math.isfinite, variances)):
        return 0.0
    least, other = variances[0] / first.widening**2, variances[1]
    variance = max(other - least, _MIN_VARIANCE_RATIO * other, _MIN_RELATIVE_DEVIATION**2)
    return abs(math.log(first.value / second.value)) / (first.widening * math.sqrt(variance))


def _value(estimate: Estimate) -> str:
    if estimate.value is None:
        return f"below {estimate.high:.3g}"
    return f"{estimate.value:.4g} ({estimate.low:.4g} to {estimate.high:.4g})"


#: Smallest ratio of the noise's to the curve's variance at a used point.
_MIN_NOISE_RATIO = 2 / 3
#: Fewest points of a curve to fit.
_MIN_POINTS = 4


def fit_of_curve(series: AxisSeries, first: NoiseFit, temperature: FloatArray | None = None) -> NoiseFit:
    """Return the GMWM fit of `first`'s model to the curve of the noise that `first` described.

    A DataError is raised if too few averaging times show the noise, or if the curve can't be fitted.
    """
    from imucal.fitting.moments import fit_gmwm

    curve = first.curve
    if first.taken_out:
        series = without_disturbances(series, first, temperature)
        curve = allan_curve(series, taus=curve.tau.tolist())
    if (share := first.noise_share) is not None:
        keep = (share > _MIN_NOISE_RATIO) & (share < 1 / _MIN_NOISE_RATIO)
        shown = np.count_nonzero(keep)
        if shown < _MIN_POINTS:
            msg = (
                f"an output filter or lines dominate the Allan variance; found {shown} "
                f"averaging times that show the noise, expected at least {_MIN_POINTS}; record for longer"
            )
            raise DataError(msg, place=series.name)
        avar = (curve.avar * share)[keep]
        curve = replace(curve, tau=curve.tau[keep], m=curve.m[keep], avar=avar, edf=curve.edf[keep])
    settings = FitSettings(model=str(first.model), method="gmwm", level=first.level)
    return fit_gmwm(series, curve, settings)


def without_disturbances(
    series: AxisSeries, first: NoiseFit, temperature: FloatArray | None = None
) -> AxisSeries:
    """Return finite samples minus the shapes that a fit took out."""
    places = series.clock.grid().astype(np.float64)
    samples = series.samples.copy()
    for regressor, coefficient in first.taken_out.items():
        samples -= coefficient * regressor.samples(places, temperature)
    return replace(series, samples=samples)


#: Lowest ordinates, which drift and the ends of the record distort.
_LOWEST = 8
#: Score from which the spectrum contradicts the model.
_CONTRADICTED = 5.0
#: Deviations from which a bin is far from the model: by chance one of 370 is.
_HIDDEN = 3.0
#: Factor from which a bin is far from the model: 14 % of a coefficient.
_NOTABLE = 1.3
#: Fewest far bins: fewer are a line.
_MIN_BINS = 3
#: Difference of log densities that the estimates' own errors can explain.
_TOLERANCE = 0.05


def unseen_spectrum() -> Finding:
    """Return the finding for a fit of a curve without a spectrum."""
    return Finding(
        "info",
        "spectral-ambiguity",
        "Only a curve was fitted, so the spectrum was not checked: spectra that differ by a ripple Phi(f) = "
        "2 Phi(2f) have the same Allan variance at every averaging time.",
        "Compare the model with the density of the samples, or fit the samples by mle.",
    )


def ambiguity_findings(result: NoiseFit, spectrum: Spectrum, axis: str) -> tuple[Finding, ...]:
    """Return a finding if a fit describes the Allan curve but not the spectrum of the samples."""
    tau = result.goodness.tau_s
    described = result.goodness.statistic < MISFIT
    if tau is None or not described or not any(term.psd(np.ones(1), 1.0)[0] for term in result.model.terms):
        return ()
    used = np.arange(spectrum.frequency.size) >= _LOWEST
    used &= spectrum.frequency <= 0.5 / tau[0]
    density = result.model.psd(spectrum.frequency, rate_hz=result.rate_hz)
    # A ramp has no density: leave out the frequencies where its power matters.
    tau0 = 1 / result.rate_hz
    slope = sum(term.coefficient * tau0 for term in result.model.terms if term.symbol == "R")
    sine = np.sin(np.pi * spectrum.frequency * tau0)
    used &= tau0 * slope**2 / (2 * result.curve.n * sine**4) < _TOLERANCE * density
    frequency, count = spectrum.frequency[used], spectrum.count[used]
    ratio = spectrum.psd[used] / density[used]
    within = np.clip(ratio, math.exp(-_TOLERANCE), math.exp(_TOLERANCE))
    score = _scores(ratio / within, count)
    far = (np.abs(score) > _HIDDEN) & (np.abs(np.log(ratio)) > math.log(_NOTABLE))
    together = float(np.sum(score**2 - 1)) / math.sqrt(2 * max(score.size, 1))
    if together < _CONTRADICTED or far.sum() < _MIN_BINS:
        return ()
    low, high = frequency[far][[0, -1]]
    worst = ratio[far][int(np.argmax(np.abs(np.log(ratio[far]))))]
    factor, side = max(worst, 1 / worst), "above" if worst > 1 else "below"
    text = (
        f"{result.model} describes the Allan curve but not the spectrum: between {low:.3g} and {high:.3g} Hz "
        f"the density is up to {factor:.3g} times {side} the model's. Spectra that differ by Phi(f) = 2 "
        "Phi(2f) have the same curve."
    )
    advice = "Look at the spectrum and fit the samples by mle. Do not use the numbers of this fit."
    return (Finding("warning", "spectral-ambiguity", text, advice, axis=axis),)


def _scores(ratio: FloatArray, count: FloatArray) -> FloatArray:
    """Return the standard-normal scores of chi-squared means of `count` over their expectation.

    Source: Wilson & Hilferty (1931), PNAS 17, 684.
    """
    variance = 2 / (9 * count)
    return np.asarray((np.cbrt(ratio) - (1 - variance)) / np.sqrt(variance))


def filtered_curve_findings(found: Iterable[Finding], method: str, axis: str) -> tuple[Finding, ...]:
    """Return a warning if an output filter shapes the curve of a fit; `found` are of the screening."""
    if not any(finding.code == "roll-off" and finding.axis == axis for finding in found):
        return ()
    text = (
        f"An output filter or a vibration shapes the Allan curve, which method {method} takes for noise: "
        "N and Q may be wrong, and their intervals are too narrow."
    )
    advice = "Use the default, `--method mle`, which fits the filter too."
    return (Finding("warning", "filtered-curve", text, advice, axis=axis),)

"""A fit held against another of the same samples.

`second_opinion` is Hausman's test of a maximum-likelihood fit against the fit of the Allan curve:
where the model is right both estimate the same numbers, and the variance of their difference is
the difference of their variances, because the first has the least there can be. Where it is not,
they weigh frequencies differently and part. `verify_findings` compares the maximum with that of
the exact state-space likelihood.

Source: Hausman (1978), "Specification tests in econometrics", Econometrica 46, 1251, eq. (2.7).
"""

import math

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding, Level
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.noise.model import NoiseModel
from imucal.noise.terms import TERMS, term_keys
from imucal.recording import AxisSeries

#: Estimates further apart than so many standard deviations are reported.
_DISAGREEMENT = 3.0
#: Standard deviation, relative, below which a difference is of no use to anybody.
_LEAST = 1 / 300
#: Terms that an output filter hides from the curve.
_OF_SHORT_TIMES = {"Q", "N"}
#: Least share of the second variance in that of the difference: both are estimates themselves.
_LEAST_SHARE = 0.25
#: Distance of the two maxima, in standard errors, that is reported as a warning.
_FAR = 0.5


def second_opinion(mle: NoiseFit, gmwm: NoiseFit) -> tuple[Finding, ...]:
    """Return a finding for each term on which two fits of one axis disagree.

    Coefficients that both estimated are compared on a logarithmic scale; a term that one of them
    bounds disagrees where the other's interval lies above the bound. Behind an output filter the
    terms of short times, Q and N, are not compared: the likelihood has taken the filter out, the
    curve still holds it.

    Notes
    -----
    The variance of a difference is taken as at least a quarter of the second fit's, and as (1/300)²:
    differences below 1 % are never reported. Where segments of the record differ, both fits are as much
    less sure as the first one's interval is wider.
    """
    findings = []
    filtered = any(finding.code == "output-filter" for finding in mle.findings)
    for first in mle.estimates:
        if filtered and first.symbol in _OF_SHORT_TIMES:
            continue
        second = next((e for e in gmwm.estimates if e.key == first.key), None)
        if second is None:
            continue
        distance = _distance(mle, gmwm, first, second)
        if distance > _DISAGREEMENT:
            findings.append(_finding(mle, gmwm, first, second))
    return tuple(findings)


def _distance(mle: NoiseFit, gmwm: NoiseFit, first: Estimate, second: Estimate) -> float:
    """Return how far apart two estimates are, in standard deviations; 0 where they can't be compared."""
    if first.value is None or second.value is None:
        apart = first.low > second.high or second.low > first.high
        return math.inf if apart else 0.0
    variances = [_relative_variance(fit, e) for fit, e in ((mle, first), (gmwm, second))]
    if not all(map(math.isfinite, variances)):
        return 0.0
    least, other = variances[0] / first.widening**2, variances[1]
    variance = max(other - least, _LEAST_SHARE * other, _LEAST**2)
    return abs(math.log(first.value / second.value)) / (first.widening * math.sqrt(variance))


def _relative_variance(fit: NoiseFit, estimate: Estimate) -> float:
    """Return the squared relative standard error of a coefficient; NaN where it is not known."""
    name = TERMS[estimate.symbol].parameter_names(estimate.key)[0]
    if name not in fit.parameters or not estimate.value:
        return math.nan
    place = fit.parameters.index(name)
    return float(fit.covariance[place, place]) / estimate.value**2


def _finding(mle: NoiseFit, gmwm: NoiseFit, first: Estimate, second: Estimate) -> Finding:
    said = " and ".join(
        f"{_value(estimate)} by {fit.method}" for fit, estimate in ((mle, first), (gmwm, second))
    )
    axis = next((f.axis for f in (*mle.findings, *gmwm.findings) if f.axis), None)
    text = f"{first.key} is {said}: the two disagree, so the model does not hold at all frequencies."
    advice = "Look at the curve and the spectrum, and trust neither interval."
    return Finding(level="warning", code="second-opinion", axis=axis, text=text, advice=advice)


def _value(estimate: Estimate) -> str:
    if estimate.value is None:
        return f"below {estimate.high:.3g}"
    return f"{estimate.value:.4g} ({estimate.low:.4g} to {estimate.high:.4g})"


def verify_findings(
    series: AxisSeries, model: NoiseModel, names: tuple[str, ...], covariance: FloatArray
) -> tuple[Finding, ...]:
    """Return how far the exact likelihood's maximum is from `model`, in standard errors.

    Slow: some seconds for 1e5 samples. `names` and `covariance`, shape (p, p), are the fit's own.
    """
    distance = distances(series, model, names, covariance)
    worst = max(distance, key=lambda name: distance[name], default="")
    if not worst:
        return ()
    far = distance[worst] > _FAR
    level: Level = "warning" if far else "info"
    text = "The exact state-space likelihood has its maximum "
    text += f"{distance[worst]:.2g} standard errors away at most ({worst})."
    advice = "Trust neither alone: look for lines, a filter or a misfit." if far else ""
    return (Finding(level=level, code="verified", axis=series.name, text=text, advice=advice),)


def distances(
    series: AxisSeries, model: NoiseModel, names: tuple[str, ...], covariance: FloatArray
) -> dict[str, float]:
    """Return how far each parameter is from the exact likelihood's maximum, in standard errors."""
    from imucal.fitting.state_space import fit_exact

    structure = tuple(term.symbol for term in model.terms)
    exact, _ = fit_exact(series, structure, model)
    here, there = _values(model), _values(exact)
    deviation = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return {
        name: abs(there[name] - here[name]) / deviation[name]
        for name in here
        if np.isfinite(deviation[name]) and deviation[name] > 0
    }


def _values(model: NoiseModel) -> dict[str, float]:
    """Return the model's parameters under the names that a fit's covariance uses."""
    keys = term_keys(term.symbol for term in model.terms)
    return {
        name: abs(value)
        for term, key in zip(model.terms, keys, strict=True)
        for name, value in zip(term.parameter_names(key), term.values, strict=True)
    }

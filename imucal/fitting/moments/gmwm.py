"""GMWM: the noise model whose Allan variances are nearest to the measured ones.

The generalised method of wavelet moments on the overlapping Allan variance. The weight ``full`` is the
inverse covariance of the curve: first of the largest model, then of the chosen one. The weight ``eta3``
ignores the correlation of averaging times.

If a weak term is dropped, its neighbour absorbs its power. So the limits of N, B and K of a chosen model also
cover those of the models whose criterion is near.

Source: Guerrier, Skaloud, Stebler & Victoria-Feser (2013), "Wavelet-variance-based estimation for composite
stochastic processes", JASA 108, 1021; the full covariance: `imucal.fitting.moments.points`.
"""

from dataclasses import replace

import numpy as np
import scipy

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Transform
from imucal.arrays import FloatArray, read_only
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting.moments.points import AvarPoints, avar_points, is_timed
from imucal.fitting.moments.search import (
    CurveFit,
    Solution,
    best_band,
    converged,
    curve_estimates,
    goodness,
)
from imucal.fitting.noise_fit import MISFIT, Candidate, Estimate, Goodness, NoiseFit
from imucal.fitting.settings import FitSettings
from imucal.fitting.spectral.bounds import either
from imucal.fitting.spectral.selection import LISTED_WITHIN, alternatives_among
from imucal.noise.model import structure_text
from imucal.recording import AxisSeries

#: The limits of N, B and K cover those of models whose criterion is within this of the chosen one. In 100
#: simulated records of 10 min, Gauss-Markov noise of 10 s was read as B in 9; in 25 with a distance of 6, and
#: in 68 without other models.
_COVERED_WITHIN = 9.0


def fit_gmwm(
    series: AxisSeries | None,
    curve: AllanCurve,
    settings: FitSettings,
    _temperature: FloatArray | None = None,
    _transform: Transform | None = None,
) -> NoiseFit:
    """Fit a noise model to Allan variances, overlapping or standard; `series` is None for a curve alone.

    With full weights, the shortest averaging times are left out behind an output filter. A curve with too few
    averaging times, or of other variances, raises a DataError.
    """
    points = avar_points(series, curve)
    if (structure := settings.structure) is not None:
        needed = len(structure) + sum(map(is_timed, structure))
        if points.size < needed:
            msg = (
                f"{points.size} averaging times are too few for "
                f"{needed} parameters of {structure_text(structure)}; record for longer or leave terms out"
            )
            raise DataError(msg, place=series.name if series else "the curve")
    kept, fitted = best_band(points, np.diag(1 / _eta3_widths(points)), settings)
    solution = fitted.solution
    near = [(delta, other) for delta, other in fitted.ranking if delta <= LISTED_WITHIN]
    estimates, names, covariance = curve_estimates(kept, solution, fitted.weight, level=settings.level)
    if settings.structure is None:
        estimates = _with_other_models(estimates, kept, fitted, settings)
    spread = solution.covariance(kept)
    fit = goodness(kept, solution, spread)
    return NoiseFit(
        method="gmwm",
        sensor=series.sensor if series is not None else None,
        rate_hz=series.rate_hz if series is not None else 1 / kept.tau0,
        level=settings.level,
        model=solution.model(kept),
        estimates=estimates,
        parameters=names,
        covariance=read_only(covariance),
        goodness=fit,
        curve=_with_edf(curve, kept, solution, spread),
        used=kept.used,
        candidates=tuple(Candidate(structure=structure_text(s.symbols), delta=d) for d, s in near),
        criterion=settings.chosen_by,
        findings=_findings(series, kept, fit, points.size - kept.size, structure_text(solution.symbols)),
        settings={"weights": settings.weights},
    )


def _with_other_models(
    estimates: tuple[Estimate, ...], points: AvarPoints, fitted: CurveFit, settings: FitSettings
) -> tuple[Estimate, ...]:
    """Return estimates whose limits also cover the near models, with their alternative terms."""
    near = [model for delta, model in fitted.ranking[1:] if delta <= _COVERED_WITHIN]
    for model in near:
        # A ramp alone does not scatter, so its Allan variances have no weight.
        if model.covariance(points).any():
            fit = converged(points, model, fitted.weight, full=settings.weights == "full")
            others, _, _ = curve_estimates(points, fit.solution, fit.weight, level=settings.level)
            estimates = either(estimates, others)
    alternatives = alternatives_among([fitted.solution.symbols, *(model.symbols for model in near)])
    return tuple(replace(e, alternatives=alternatives[e.symbol]) for e in estimates)


def _eta3_widths(points: AvarPoints) -> FloatArray:
    """Return the widths of the 95 % chi-squared intervals with eta3 degrees of freedom, shape (k,).

    Source: Percival & Walden (2000), "Wavelet methods for time series analysis", eq. (314c).
    """
    terms = points.n - 2 * points.m + 1
    edf = np.maximum(terms / (2 * points.m), 1.0)
    width = edf * points.avar * (1 / scipy.special.chdtri(edf, 0.975) - 1 / scipy.special.chdtri(edf, 0.025))
    return np.asarray(width, dtype=np.float64)


def _with_edf(
    curve: AllanCurve, points: AvarPoints, solution: Solution, covariance: FloatArray
) -> AllanCurve:
    if np.any(np.isfinite(curve.edf)):
        return curve
    edf = 2 * solution.avar(points) ** 2 / np.diag(covariance)
    every = np.interp(np.log(curve.m), np.log(points.m), np.log(edf))
    return replace(curve, edf=np.maximum(np.exp(every), 1.0), edf_method="model")


def _findings(
    series: AxisSeries | None, points: AvarPoints, fit: Goodness, dropped: int, text: str
) -> tuple[Finding, ...]:
    axis = series.name if series is not None else None
    first, last = fit.tau_s or (0.0, 0.0)
    findings: list[Finding] = []
    if not points.known_n:
        sentence = (
            f"The length of the record is unknown. The intervals assume {2 * last:.4g} s, the shortest that "
            "allows the longest averaging time."
        )
        long = "Give the number of samples for narrower intervals."
        findings.append(Finding("info", "record-length-unknown", sentence, long, axis=axis))
    if dropped:
        sentence = (
            f"No model describes averaging times below {first:.4g} s, as with an output filter; the fit "
            "starts there."
        )
        findings.append(Finding("warning", "short-times", sentence, axis=axis))
    if fit.statistic >= MISFIT:
        sentence = f"{text} does not describe the curve: its misfit is {fit.chi2_per_bin:.1f}, expected 1."
        advice = "Look at the curve and the spectrum before using the numbers."
        findings.append(Finding("warning", "poor-fit", sentence, advice, axis=axis))
    if " + " in text:
        sentence = (
            "The intervals of this method are too narrow if it chooses the model: in simulated records of "
            "N + B + K they contained the true B in nine of ten cases."
        )
        advice = "Use the default, `--method mle`." if series else "Fit the log itself if you have it."
        findings.append(Finding("warning", "narrow-intervals", sentence, advice, axis=axis))
    if series is not None and series.clock.missing:
        sentence = (
            "The intervals of a curve fit allow for the number of missing samples, not for their times."
        )
        findings.append(Finding("info", "gaps-in-curve", sentence, axis=axis))
    return tuple(findings)

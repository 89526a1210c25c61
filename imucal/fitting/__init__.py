"""AllanCurve (+ samples) -> NoiseFit: what explains it."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucal.allan import AllanCurve, allan_curve
from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import NoiseFit
from imucal.noise.model import parse_structure
from imucal.noise.terms import require_fittable
from imucal.recording import AxisSeries

if TYPE_CHECKING:
    from imucal.findings import Finding

__all__ = ["CRITERIA", "METHODS", "WEIGHTS", "fit"]

#: The methods: maximum likelihood, generalised method of wavelet moments, reading of slopes.
METHODS = ("mle", "gmwm", "slope")

#: Information criteria that choose between models.
CRITERIA = ("bic", "hq", "aic")

#: Weights of gmwm: full covariance of the curve, or the published diagonal.
WEIGHTS = ("full", "eta3")


def fit(
    series: AxisSeries | AllanCurve,
    *,
    model: str = "auto",
    method: str = "mle",
    level: float = 0.95,
    criterion: str = "bic",
    weights: str = "full",
    clean: bool = True,
    verify: bool = False,
    temperature: FloatArray | None = None,
    curve: AllanCurve | None = None,
    max_gm: int = 2,
) -> NoiseFit:
    """Fit a noise model to one axis.

    Parameters
    ----------
    series
        The samples; or a curve alone, which `gmwm` and `slope` can do with.
    model
        ``auto`` chooses among all sums of the terms; or the terms, such as ``N + B + K`` or
        ``N + 2*GM + K``.
    method
        ``mle``: maximum likelihood on the samples' spectrum. ``gmwm``: generalised method of wavelet
        moments on the Allan curve. ``slope``: the classical reading of slopes.
    level
        Confidence level of every interval.
    criterion
        ``bic``, ``hq`` (Hannan-Quinn) or ``aic``: what chooses between models.
    weights
        Of gmwm: ``full`` covariance of the curve, or ``eta3``, the published diagonal.
    clean
        Replace spikes before fitting; they are counted in a finding.
    verify
        Compare the maximum with the exact state-space likelihood, and say how far apart they are.
    temperature
        In degrees Celsius, shape (n,), at the samples: its linear effect is taken out with the fit.
    curve
        The samples' Allan curve, where it has been computed already.
    max_gm
        Most Gauss-Markov terms that ``auto`` tries.

    Returns
    -------
    NoiseFit
        With an interval on every number; N, B and K always among its estimates.

    Raises
    ------
    ValueError
        If an argument is none of the above.
    DataError
        If the samples can't be analysed: too few, constant, not finite.
    """
    _check(method, criterion, level, weights, max_gm)
    structure = None if model == "auto" else parse_structure(model)
    require_fittable(structure or (), method)
    if isinstance(series, AllanCurve):
        if method == "mle":
            msg = "maximum likelihood needs the samples, got an Allan curve; use method 'gmwm' or 'slope'"
            raise ValueError(msg)
        return _from_curve(
            None,
            series,
            structure,
            method=method,
            level=level,
            criterion=criterion,
            weights=weights,
            max_gm=max_gm,
        )
    temperature = _at_finite(temperature, series)
    series = series.finite()
    findings: tuple[Finding, ...] = ()
    if clean:
        from imucal.fitting.robust import clean as clean_spikes

        cleaned, findings = clean_spikes(series)
        if cleaned is not series:
            series, curve = cleaned, _again(cleaned, curve)
    if curve is None:
        curve = allan_curve(series)
    if method != "mle":
        result = _from_curve(
            series,
            curve,
            structure,
            method=method,
            level=level,
            criterion=criterion,
            weights=weights,
            max_gm=max_gm,
        )
        return replace(result, findings=findings + result.findings)
    from imucal.fitting.spectral.mle import fit_mle

    result = fit_mle(
        series,
        curve,
        structure,
        level=level,
        criterion=criterion,
        max_gm=max_gm,
        temperature=temperature,
        verify=verify,
    )
    return replace(result, findings=findings + result.findings)


def _from_curve(
    series: AxisSeries | None,
    curve: AllanCurve,
    structure: tuple[str, ...] | None,
    *,
    method: str,
    level: float,
    criterion: str,
    weights: str,
    max_gm: int,
) -> NoiseFit:
    """Fit by one of the methods that need the curve only."""
    if method == "slope":
        from imucal.fitting.moments.slope import fit_slope

        return fit_slope(series, curve, structure, level=level)
    from imucal.fitting.moments.gmwm import fit_gmwm

    return fit_gmwm(
        series, curve, structure, level=level, criterion=criterion, weights=weights, max_gm=max_gm
    )


def _again(series: AxisSeries, curve: AllanCurve | None) -> AllanCurve | None:
    """Return a curve of the cleaned samples at the same averaging times, None for None."""
    if curve is None:
        return None
    edf = curve.edf_method or "hybrid"
    return allan_curve(series, taus=curve.tau.tolist(), estimator=curve.estimator, edf=edf)


def _at_finite(temperature: FloatArray | None, series: AxisSeries) -> FloatArray | None:
    """Return the temperatures at the finite samples."""
    if temperature is None:
        return None
    temperature = np.asarray(temperature, dtype=np.float64)
    if temperature.shape != (series.n,):
        msg = f"temperature must have shape ({series.n},) like the samples, got {temperature.shape}"
        raise ValueError(msg)
    return temperature[series.usable]


def _check(method: str, criterion: str, level: float, weights: str, max_gm: int) -> None:
    choices = (("method", method, METHODS), ("criterion", criterion, CRITERIA), ("weights", weights, WEIGHTS))
    for name, value, known in choices:
        if value not in known:
            msg = f"{name} {value!r} is not one of {', '.join(known)}"
            raise ValueError(msg)
    if not 0 < level < 1:
        msg = f"level must be between 0 and 1, got {level}"
        raise ValueError(msg)
    if not 0 <= max_gm <= 2:
        msg = f"max_gm must be 0, 1 or 2, got {max_gm}"
        raise ValueError(msg)

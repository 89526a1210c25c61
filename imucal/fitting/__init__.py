"""AllanCurve (+ samples) -> NoiseFit."""

from dataclasses import replace

import numpy as np

from imucal.allan import AllanCurve, allan_curve, spectrum
from imucal.allan.dct import Transform
from imucal.allan.engine import refuse_tiny
from imucal.arrays import FloatArray
from imucal.fitting.cross_checks import ambiguity_findings, filtered_curve_findings, unseen_spectrum
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.fitting.robust import clean as clean_spikes
from imucal.fitting.settings import CRITERIA, METHODS, WEIGHTS, FitSettings, load_method
from imucal.fitting.spectral.blocks import size_of_steps
from imucal.recording import AxisSeries

__all__ = ["CRITERIA", "METHODS", "WEIGHTS", "Estimate", "FitSettings", "NoiseFit", "fit", "fit_axis"]


def fit(
    series: AxisSeries | AllanCurve,
    *,
    model: str = "auto",
    method: str = "mle",
    level: float = 0.95,
    criterion: str = "chance",
    weights: str = "full",
    clean: bool = True,
    temperature: FloatArray | None = None,
    curve: AllanCurve | None = None,
    max_gm: int = 2,
    segments: int = 8,
) -> NoiseFit:
    """Fit a noise model to one axis.

    Parameters
    ----------
    series
        The samples, or a curve alone for `gmwm` and `slope`.
    model
        ``auto`` chooses among all sums of the terms; or terms, such as ``N + B + K`` or ``N + 2*GM + K``.
    method
        ``mle``: maximum likelihood on the samples' spectrum. ``gmwm``: generalised method of wavelet
        moments on the Allan curve. ``slope``: the classical reading of slopes.
    level
        Confidence level of every interval.
    criterion
        Criterion of the choice: ``chance``, the same at any rate, ``bic``, ``hq`` (Hannan-Quinn) or ``aic``.
    weights
        For gmwm: ``full`` covariance of the curve, or ``eta3``, the published diagonal.
    clean
        Replace spikes before fitting; they are counted in a finding.
    temperature
        In degrees Celsius, shape (n,), at the samples: the fit takes out its linear effect.
    curve
        The samples' Allan curve, if already computed.
    max_gm
        Largest number of Gauss-Markov terms that ``auto`` tries.
    segments
        For mle: largest number of parts of equal time in which changes of the noise are tested; 1 skips
        the test. If the noise changes, intervals are wider.

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
    settings = FitSettings(
        model=model,
        method=method,
        level=level,
        criterion=criterion,
        weights=weights,
        max_gm=max_gm,
        clean=clean,
        segments=segments,
    )
    result = fit_axis(series, settings, temperature=temperature, curve=curve)
    if isinstance(series, AllanCurve) or settings.method == "mle":
        return result
    from imucal.fitting.spectral.disturbances.not_noise import not_noise

    found = ambiguity_findings(result, spectrum(series), series.name)
    found += filtered_curve_findings(not_noise(series.finite()), settings.method, series.name)
    return replace(result, findings=result.findings + found)


def fit_axis(
    series: AxisSeries | AllanCurve,
    settings: FitSettings,
    *,
    temperature: FloatArray | None = None,
    curve: AllanCurve | None = None,
    transform: Transform | None = None,
) -> NoiseFit:
    """Fit a noise model to one axis, like `fit`, with a `FitSettings`.

    A `transform` of the finite samples saves time; None computes it.
    The caller compares a fit of the curve with the spectrum (`ambiguity_findings`).
    """
    method = load_method(settings.method)
    if isinstance(series, AllanCurve):
        result = method(None, series, settings, None, None)
        return replace(result, findings=(*result.findings, unseen_spectrum()))
    if temperature is not None:
        temperature = np.asarray(temperature, dtype=np.float64)
        if temperature.shape != (series.n,):
            msg = f"temperature must have shape ({series.n},) like the samples, got {temperature.shape}"
            raise ValueError(msg)
        temperature = temperature[series.usable]
    series = series.finite()
    refuse_tiny(series)
    if settings.method != "mle" and series.n > 1:
        # Maximum likelihood does the same.
        size_of_steps(series)
    cleaned, findings = clean_spikes(series) if settings.clean else (series, ())
    if cleaned is not series or (transform is None and curve is None):
        transform = Transform.of(cleaned)
    if curve is None:
        curve = allan_curve(cleaned, transform=transform)
    elif cleaned is not series:
        curve = allan_curve(cleaned, taus=curve.tau.tolist(), transform=transform)
    result = method(cleaned, curve, settings, temperature, transform)
    goodness = replace(result.goodness, spikes=_rms_difference(series, cleaned))
    return replace(result, findings=findings + result.findings, goodness=goodness)


def _rms_difference(series: AxisSeries, cleaned: AxisSeries) -> float:
    """Return the root of the mean square of what cleaning removed, in U."""
    if cleaned is series:
        return 0.0
    return float(np.sqrt(np.mean((series.samples - cleaned.samples) ** 2)))

"""A fit of the Allan curve of what the likelihood fitted: without what that took out of the samples.

A second opinion is about the same noise. So the shapes that the first fit took out, such as cycles,
steps and the temperature, are taken out of the samples; and at averaging times where its output
filter or lines shape the curve, that is brought to the noise's own, or left out if there is more of
them than of it.
"""

from dataclasses import replace

import numpy as np

from imucal.allan import AllanCurve
from imucal.allan.engine import same_curve
from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.fitting.moments import fit_gmwm
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.settings import FitSettings
from imucal.fitting.spectral.ordinates import regressor_samples
from imucal.recording import AxisSeries

#: A point is left out of which less than this share is noise, or which has less than this share of the noise.
_LEAST_SHARE = 2 / 3
#: Fewest points of a curve that can contradict anything.
_FEWEST = 4


def fit_of_curve(series: AxisSeries, first: NoiseFit, temperature: FloatArray | None = None) -> NoiseFit:
    """Return the GMWM fit of `first`'s model to the curve of the samples it had, as it saw them.

    Raises
    ------
    DataError
        If too few averaging times show the noise, or the curve can't be fitted.
    """
    curve = first.curve
    if first.taken_out:
        series = without_disturbances(series, first, temperature)
        curve = same_curve(series, curve)
    settings = FitSettings(model=str(first.model), method="gmwm", level=first.level)
    return fit_gmwm(series, _of_noise(curve, first.noise_share, series.name), settings)


def without_disturbances(
    series: AxisSeries, first: NoiseFit, temperature: FloatArray | None = None
) -> AxisSeries:
    """Return finite samples less what a fit took out of them."""
    places = series.clock.grid().astype(np.float64)
    samples = series.samples.copy()
    for name, size in first.taken_out.items():
        samples -= size * regressor_samples(name, places, temperature)
    return replace(series, samples=samples)


def _of_noise(curve: AllanCurve, share: FloatArray | None, axis: str) -> AllanCurve:
    """Return the curve of the noise alone, at the averaging times that show it."""
    if share is None:
        return curve
    keep = (share > _LEAST_SHARE) & (share < 1 / _LEAST_SHARE)
    shown = np.count_nonzero(keep)
    if shown < _FEWEST:
        msg = (
            f"{axis}: an output filter or lines shape the Allan variance, and {shown} averaging times show "
            f"the noise, expected at least {_FEWEST}; record for longer"
        )
        raise DataError(msg)
    return replace(
        curve, tau=curve.tau[keep], m=curve.m[keep], avar=(curve.avar * share)[keep], edf=curve.edf[keep]
    )

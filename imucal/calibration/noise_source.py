"""Which noise a calibration starts from: the models of a report, or the white noise within the rests."""

import math
from collections.abc import Mapping

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.mean_covariance import mean_covariance, white_model
from imucal.calibration.poses import RestMeans, Triad
from imucal.errors import DataError
from imucal.fitting.noise_fit import NoiseFit
from imucal.frozen import frozen
from imucal.noise import TERMS, NoiseModel, NoiseTerm
from imucal.prediction.propagation import MEAN
from imucal.recording import AXES
from imucal.report.result import Report

__all__ = ["NoiseBase", "base_covariance", "noise_base", "report_models"]

#: Terms that a fit may only bound and that count all the same.
_SLOW = ("N", "B", "K")


@frozen
class NoiseBase:
    """Noise of three axes.

    `origin` is ``report``, ``given`` or ``rests``; `checked` is true for the first two, which describe slow
    noise too. `ratio` is the deviation of the samples by the models, divided by that within the rests; the
    ratio of the axis that differs most.
    """

    models: tuple[NoiseModel, ...]
    origin: str
    ratio: float = 1.0

    @property
    def checked(self) -> bool:
        """Whether the models include slow noise."""
        return self.origin != "rests"


def noise_base(noise: Report | Mapping[str, NoiseModel] | None, data: Triad, rests: RestMeans) -> NoiseBase:
    """Return the noise of a sensor's axes.

    Parameters
    ----------
    noise
        A report of a long static log, or models by axis name such as ``accel_x``, in the units of the log.
        None for the white noise within the rests.
    data, rests
        The sensor and its rests.

    Raises
    ------
    DataError
        If an axis has no model.
    """
    if noise is None:
        models = tuple(white_model(float(deviation), data.rate_hz) for deviation in rests.deviations)
        return NoiseBase(models=models, origin="rests")
    origin = "report" if isinstance(noise, Report) else "given"
    known = report_models(noise) if isinstance(noise, Report) else noise
    names = [f"{data.sensor.short}_{axis}" for axis in AXES]
    if missing := [name for name in names if name not in known]:
        raise DataError(f"no noise model of {', '.join(missing)}; fit a static log of the same IMU")
    models = tuple(known[name] for name in names)
    lag = np.array([round(1.0 * data.rate_hz)])
    by_model = [math.sqrt(model.structure(lag, rate_hz=data.rate_hz)[0] / 2) for model in models]
    ratios = np.array(by_model) / rests.deviations
    return NoiseBase(models=models, origin=origin, ratio=float(ratios[np.argmax(np.abs(np.log(ratios)))]))


def report_models(report: Report) -> dict[str, NoiseModel]:
    """Return the model of each axis of a report, with bounded terms at their expected size."""
    return {axis.name: _model(axis.fit) for axis in report.axes}


def base_covariance(base: NoiseBase, data: Triad, rests: RestMeans) -> FloatArray:
    """Return the covariance of the rests' means of each axis, shape (3, m, m)."""
    return np.array(
        [
            mean_covariance(model, rests.spans, rate_hz=data.rate_hz, samples=len(data.samples))
            for model in base.models
        ]
    )


def _model(fit: NoiseFit) -> NoiseModel:
    terms: list[NoiseTerm] = []
    for estimate in fit.estimates:
        value = estimate.value if estimate.value is not None else estimate.drawn
        if value is None and math.isfinite(estimate.high) and estimate.symbol in _SLOW:
            value = estimate.high * math.sqrt(MEAN.bounded)
        if not value:
            continue
        # Flicker covers a Gauss-Markov term of unknown correlation time.
        unknown_time = estimate.symbol == "GM" and estimate.correlation_time is None
        terms.append(TERMS["B"].of(value) if unknown_time else estimate.term(value))
    return NoiseModel(terms=tuple(terms))

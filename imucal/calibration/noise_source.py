"""The noise that a calibration starts from: the models of a report, or the white noise within the rests."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.mean_covariance import mean_covariance, white_model
from imucal.calibration.poses import RestMeans, Triad
from imucal.errors import DataError
from imucal.fitting.noise_fit import NoiseFit
from imucal.noise import TERMS, NoiseModel, NoiseTerm
from imucal.prediction.propagation import MEAN
from imucal.recording import AXES
from imucal.report.result import Report

__all__ = ["NoiseBase", "base_covariance", "noise_base", "report_models", "white_models"]

#: Terms that count even if a fit only bounds them.
_SLOW = ("N", "B", "K")
#: Factor from which noise has another unit: no unit of samples is nearer to SI, except g.
_OTHER_UNIT = 30.0


@dataclass(frozen=True, kw_only=True)
class NoiseBase:
    """Noise of three axes.

    `origin` is ``report``, ``given`` or ``rests``. `ratio` is the deviation of the samples by the models,
    divided by that within the rests, of the axis that differs most. `factors` are raw units per SI unit.
    """

    models: tuple[NoiseModel, ...]
    origin: str
    ratio: float = 1.0
    factors: tuple[float, ...] = ()

    @property
    def checked(self) -> bool:
        """Whether the models include slow noise."""
        return self.origin != "rests"


def noise_base(
    noise: Report | Mapping[str, NoiseModel] | None,
    data: Triad,
    rests: RestMeans,
    scale: Callable[[RestMeans], FloatArray],
) -> NoiseBase:
    """Return the noise of a sensor's axes.

    `noise` is a report of a long static log, or models by axis name, in SI or in the unit of the log; None
    for the white noise within the rests. `scale` returns raw units per SI unit of each axis. A DataError is
    raised if an axis has no model, or if its noise has neither unit.
    """
    if noise is None:
        return NoiseBase(models=white_models(data, rests), origin="rests")
    origin = "report" if isinstance(noise, Report) else "given"
    known = report_models(noise) if isinstance(noise, Report) else noise
    names = [f"{data.sensor.short}_{axis}" for axis in AXES]
    if missing := [name for name in names if name not in known]:
        raise DataError(f"no noise model of {', '.join(missing)}; fit a static log of the same IMU")
    models = tuple(known[name] for name in names)
    as_given = NoiseBase(models=models, origin=origin, ratio=_ratio(models, data, rests))
    if not _is_other_unit(as_given.ratio):
        return as_given
    factors = scale(rests)
    models = tuple(_scaled(model, factor) for model, factor in zip(models, factors.tolist(), strict=True))
    ratio = _ratio(models, data, rests)
    if not _is_other_unit(ratio):
        return NoiseBase(models=models, origin=origin, ratio=ratio, factors=tuple(factors.tolist()))
    short = data.sensor.short
    advice = f"fit the log at rest again with the right --{short}-unit or --{short}-scale"
    if as_given.ratio < 1:
        advice += "; if a hand held the IMU, calibrate without --noise"
    msg = (
        f"the noise report has {as_given.ratio:.2g} times the noise of the rests ({short}); expected SI "
        f"units or the unit of the log; {advice}"
    )
    raise DataError(msg)


def white_models(data: Triad, rests: RestMeans) -> tuple[NoiseModel, ...]:
    """Return the white noise within the rests."""
    return tuple(white_model(float(deviation), data.rate_hz) for deviation in rests.deviations)


def _ratio(models: tuple[NoiseModel, ...], data: Triad, rests: RestMeans) -> float:
    lag = np.array([round(1.0 * data.rate_hz)])
    by_model = [math.sqrt(model.structure(lag, rate_hz=data.rate_hz)[0] / 2) for model in models]
    ratios = np.array(by_model) / rests.deviations
    return float(ratios[np.argmax(np.abs(np.log(ratios)))])


def _is_other_unit(ratio: float) -> bool:
    return not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT


def _scaled(model: NoiseModel, factor: float) -> NoiseModel:
    terms = (type(term).of(factor * term.coefficient, *term.values[1:]) for term in model.terms)
    return NoiseModel(terms=tuple(terms))


def report_models(report: Report) -> dict[str, NoiseModel]:
    """Return the model of each axis of a report, with bounded terms at their expected size."""
    return {axis.name: _model(axis.fit) for axis in report.axes}


def base_covariance(models: tuple[NoiseModel, ...], data: Triad, rests: RestMeans) -> FloatArray:
    """Return the covariance of the rests' means of each axis, shape (3, m, m)."""
    return np.array(
        [
            mean_covariance(model, rests.spans, rate_hz=data.rate_hz, samples=len(data.samples))
            for model in models
        ]
    )


def _model(fit: NoiseFit) -> NoiseModel:
    terms: list[NoiseTerm] = []
    for estimate in fit.estimates:
        value = estimate.value if estimate.value is not None else estimate.in_model
        if value is None and math.isfinite(estimate.high) and estimate.symbol in _SLOW:
            value = estimate.high * math.sqrt(MEAN.bounded)
        if not value:
            continue
        # Flicker covers a Gauss-Markov term of unknown time.
        unknown_time = estimate.symbol == "GM" and estimate.correlation_time is None
        terms.append(TERMS["B"].of(value) if unknown_time else estimate.term(value))
    return NoiseModel(terms=tuple(terms))

"""Reports of numbers that were not fitted to a record: a data sheet's model, a bound over many units."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, get_args

import numpy as np

from imucal._version import __version__
from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Spectrum
from imucal.errors import DataError, Fix
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate, Goodness, Interval, NoiseFit
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS, term_keys
from imucal.recording import Axis, Sensor, Source
from imucal.report.result import AxisReport, Overview, Report

if TYPE_CHECKING:
    from imucal.sensors import Part

GIVEN = "given"
#: Origin of numbers of a data sheet.
FROM_SHEET = "from the data sheet, not measured"
#: Assumed length of the record, in s.
_RECORD_S = 3 * 3600.0


def model_as_report(models: Mapping[Sensor, str], *, rate_hz: float) -> Report:
    """Return models, for example from a data sheet, in the form of the report of one log.

    All axes of a sensor have its model, without intervals. N, B and K are zero if the model lacks them.

    Parameters
    ----------
    models
        Sensor -> model, as a text for `NoiseModel.parse`.
    rate_hz
        Sampling rate in Hz, for numbers per sample.

    Raises
    ------
    ValueError
        If a text is no model of its sensor.
    """
    axes = []
    for sensor in Sensor:
        if sensor in models:
            estimates = _estimates(NoiseModel.parse(models[sensor], sensor))
            one = given_axis(sensor, "x", estimates, rate_hz=rate_hz, duration_s=_RECORD_S, method=GIVEN)
            # All axes share one result.
            axes += [replace(one, axis=letter, samples=0) for letter in get_args(Axis)]
    message = "; ".join(f"{models[sensor]} ({sensor})" for sensor in Sensor if sensor in models)
    return Report(
        source=Source(path=message, format="a model as given, no log"),
        axes=tuple(axes),
        settings={"models": {str(sensor): text for sensor, text in models.items()}, "rate_hz": rate_hz},
        version=__version__,
        findings=(Finding("info", "rate-given", f"The rate, {rate_hz:g} Hz, was given."),),
    )


def part_as_report(part: "Part", *, rate_hz: float) -> Report:
    """Return the figures of a data sheet in the form of the report of one log.

    Parameters
    ----------
    part
        From `imucal.sensor`.
    rate_hz
        Sampling rate in Hz, for numbers per sample.

    Raises
    ------
    DataError
        If the data sheet prints N of no sensor.
    """
    models = part_models(part)
    if not models:
        advice = Fix("record a log at rest and run 'imucal fit' on it")
        raise DataError("the data sheet prints no N", place=part.name, fix=advice)
    report = model_as_report(models, rate_hz=rate_hz)
    axes = []
    for axis in report.axes:
        estimates = [replace(each, origin=FROM_SHEET) for each in axis.fit.estimates]
        axes.append(replace(axis, fit=replace(axis.fit, estimates=tuple(estimates))))
    documents = "; ".join(part.sources)
    return replace(
        report,
        source=Source(path=part.name, format=f"{FROM_SHEET}: {documents}; figures: {part.confidence}"),
        axes=tuple(axes),
        settings={**report.settings, "sensor": part.name},
    )


def part_models(part: "Part") -> dict[Sensor, str]:
    """Return the model of each sensor whose N the data sheet prints, as a text in SI."""
    return {
        sensor: " + ".join(f"{symbol}={term.reference!r}" for symbol, term in own.terms.items())
        for sensor, own in part.sensors.items()
        if "N" in own.terms
    }


def _estimates(model: NoiseModel) -> list[Estimate]:
    """Return exact estimates of a model's terms, and zero for other terms of `ALWAYS`."""
    found = []
    for key, term in zip(term_keys(term.symbol for term in model.terms), model.terms, strict=True):
        value, *times = term.values
        time = Interval(value=times[0], low=times[0], high=times[0]) if times else None
        found.append(
            Estimate(
                key=key,
                symbol=term.symbol,
                status="estimated",
                value=value,
                low=value,
                high=value,
                correlation_time=time,
                origin="as given",
            )
        )
    there = {estimate.symbol for estimate in found}
    return [*found, *(Estimate.bounded(symbol, symbol, 0.0) for symbol in ALWAYS if symbol not in there)]


def given_axis(
    sensor: Sensor,
    axis: Axis,
    estimates: Sequence[Estimate],
    *,
    rate_hz: float,
    duration_s: float,
    method: str,
) -> AxisReport:
    """Return the result of an axis with given terms; its curve is the model's, without limits."""
    noise = NoiseModel(
        terms=tuple(
            TERMS[e.symbol].of(e.value or e.high, *([e.correlation_time.value] if e.correlation_time else []))
            for e in estimates
            if e.value or e.high
        )
    )
    size = max(int(duration_s * rate_hz), 4)
    m = 2 ** np.arange(size.bit_length() - 1)
    curve = AllanCurve(
        tau=m / rate_hz,
        m=m,
        avar=noise.avar(m.astype(np.float64), rate_hz=rate_hz),
        edf=np.full(m.size, np.nan),
        n=size,
        computed="given",
    )
    none = np.zeros(0)
    return AxisReport(
        sensor=sensor,
        axis=axis,
        samples=size,
        rate_hz=rate_hz,
        duration_s=duration_s,
        mean=0.0,
        std=0.0,
        gaps=(),
        spectrum=Spectrum(frequency=none, psd=none, count=none),
        overview=Overview(time_s=none, low=none, high=none),
        fit=NoiseFit(
            method=method,
            sensor=sensor,
            rate_hz=rate_hz,
            level=0.95,
            model=noise,
            estimates=tuple(estimates),
            parameters=(),
            covariance=np.zeros((0, 0)),
            goodness=Goodness(statistic=0.0, p_value=1.0, chi2_per_bin=1.0),
            curve=curve,
            used=np.arange(m.size),
        ),
    )

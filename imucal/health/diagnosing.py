"""Recording -> diagnosis, one row per question."""

import numpy as np

from imucal._version import __version__
from imucal.health.axes import axes_row, explaining_orders
from imucal.health.clipping import range_row
from imucal.health.clocks import clock_rows
from imucal.health.delay import delay_row
from imucal.health.diagnosis import Diagnosis, Question, Row, Values
from imucal.health.evidence import Curve, Evidence, Limit, thinned
from imucal.health.samples import sample_rows
from imucal.health.spectrum import filter_row, vibration_row
from imucal.health.stream import Stream
from imucal.health.turning import Turning, turning_parts
from imucal.health.units import (
    accelerometer_unit_row,
    check_expected,
    gravity_length,
    gravity_row,
    gyroscope_unit_row,
    has_gravity,
    up_row,
)
from imucal.recording import Recording, Temperature

__all__ = ["diagnose"]

#: Span of the temperature, in K, in which the bias of a consumer gyroscope moves by 0.2 deg/s.
_WARMED_K = 10.0


def diagnose(recording: Recording, *, expect: str | None = None) -> Diagnosis:
    """Return whether a stream is fit for a filter: one row per question, always in the same order.

    The IMU may move. Rests and turns show units, axes, signs and delays; rows that a log can't answer are
    ``unknown``, with advice on how to record one that can. `expect` is the axis that is up at the first rest,
    such as ``z-up`` or ``x-down``.

    Raises
    ------
    ChoiceError
        If `expect` is not a direction.
    """
    check_expected(expect)
    stream = Stream.of(recording)
    turning = _turning(stream)
    orders = explaining_orders(turning) if turning is not None else None
    period_s = max((series.tau0 for series in recording.series), default=0.0)
    rows = (
        *clock_rows(recording, [p for p in stream.profiles if p.windows.size]),
        accelerometer_unit_row(stream),
        gyroscope_unit_row(stream, turning, orders),
        gravity_row(stream),
        up_row(stream, expect),
        axes_row(turning, orders),
        delay_row(turning, orders, period_s=period_s),
        range_row(stream.profiles),
        *sample_rows(stream),
        filter_row(stream),
        vibration_row(stream),
        _temperature_row(recording.temperature),
    )
    return Diagnosis(source=recording.source, rows=rows, version=__version__)


def _turning(stream: Stream) -> Turning | None:
    gravity = gravity_length(stream)
    if stream.accelerometer is None or stream.gyroscope is None or not gravity or not has_gravity(stream):
        return None
    return turning_parts(stream.accelerometer, stream.gyroscope, stream.rests, gravity=gravity)


def _temperature_row(temperature: Temperature | None) -> Row:
    question = Question("temperature", "temperature")
    degrees = (
        temperature.samples[np.isfinite(temperature.samples)] if temperature is not None else np.zeros(0)
    )
    if not degrees.size:
        found = "the log has no temperature"
        return question.answer("unknown", found, "Log the temperature of the IMU.")
    low, high = (float(one) for one in np.quantile(degrees, [0.01, 0.99]))
    values: Values = {"low_degc": low, "high_degc": high}
    found = f"the temperature is between {low:.1f} and {high:.1f} °C"
    if temperature is not None and high - low > _WARMED_K:
        advice = "Switch the IMU on 15 min earlier, or compensate the bias by temperature."
        evidence = _warming(temperature, low=low, high=high)
        return question.answer("warn", found, advice, values=values, evidence=evidence)
    return question.answer("pass", found, values=values)


def _warming(temperature: Temperature, *, low: float, high: float) -> Evidence:
    clock = temperature.clock
    time = np.asarray(clock.grid() * clock.tau0, dtype=np.float64)
    x, y = thinned(time, temperature.samples)
    return Evidence(
        title="temperature of the IMU",
        x_label="time (s)",
        y_label="temperature (°C)",
        curves=(Curve(label="temperature", x=x, y=y),),
        limits=(Limit(label=f"{low:.1f} °C", value=low), Limit(label=f"{high:.1f} °C", value=high)),
    )

"""A YAML file for a program of your own: every term of every axis with its interval, in SI.

Continuous coefficients, and the discrete numbers that follow from them at the sensor's own rate. A
term that the data don't show has an ``upper_bound`` in place of a ``value``.
"""

import math
from collections.abc import Iterator

from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Body, Target, quoted, real
from imucal.report.result import AxisReport


def _body(numbers: Numbers) -> Body:
    used = [
        numbers.of(axis, symbol)
        for sensor in numbers.sensors
        for axis in numbers.axes(sensor)
        for symbol in ("N", "B", "K")
    ]
    lines = ["imu:"]
    for sensor in numbers.sensors:
        lines += [
            f"  {sensor}:",
            f"    rate_hz: {real(numbers.rate_hz(sensor))}",
            f"    unit: {quoted(sensor.unit)}",
        ]
        for axis in numbers.axes(sensor):
            lines += _axis(numbers, axis)
    return used, lines


def _axis(numbers: Numbers, axis: AxisReport) -> Iterator[str]:
    rate_hz = numbers.rate_hz(axis.sensor)
    white, walk = numbers.of(axis, "N").value, numbers.of(axis, "K").value
    yield f"    {axis.axis}:"
    yield f"      white_noise_per_sample: {real(white * math.sqrt(rate_hz))}  # N * sqrt(f)"
    yield f"      bias_step_per_sample: {real(walk / math.sqrt(rate_hz))}  # K / sqrt(f)"
    for estimate in axis.fit.estimates:
        yield f"      {estimate.key}: {{{', '.join(_members(numbers, axis, estimate))}}}"


def _members(numbers: Numbers, axis: AxisReport, estimate: Estimate) -> Iterator[str]:
    factor = numbers.choices.factor(estimate.symbol)
    if estimate.value is None:
        yield f"upper_bound: {real(estimate.high * factor)}"
    else:
        yield f"value: {real(estimate.value * factor)}"
        yield f"low: {real(estimate.low * factor)}"
        yield f"high: {real(estimate.high * factor)}"
    if estimate.correlation_time is not None:
        yield f"correlation_time_s: {real(estimate.correlation_time.value)}"
    if estimate.alternatives:
        yield f"or: [{', '.join(estimate.alternatives)}]"
    yield f"unit: {quoted(TERMS[estimate.symbol].unit(axis.sensor))}"


TARGETS = (
    Target(
        name="yaml",
        title="every term with its interval, for a program of your own",
        file_name="imu_noise.yaml",
        heading="IMU noise model",
        source="no program: every key is in the file",
        kind="coefficients are continuous, SI; *_per_sample are discrete, right for rate_hz only",
        formulas=("white_noise_per_sample = N * sqrt(f), bias_step_per_sample = K / sqrt(f)",),
        body=_body,
        carries="Q N B GM K R",
        per_axis=True,
        own_rates=True,
        notes=("limits are those of the intervals; a term with upper_bound was not identified",),
        aliases=("generic", "genericyaml"),
    ),
)

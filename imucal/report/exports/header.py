"""The comment at the head of every file: what the numbers are, and how they came about."""

import math
from collections.abc import Iterable, Sequence

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import INFLATABLE, Number, Numbers
from imucal.report.result import AxisReport

_POLICIES = {
    "worst": "worst: the largest of the sensor's axes",
    "rms": "rms: the root of the mean variance of the sensor's axes",
}


def header(
    numbers: Numbers,
    *,
    title: str,
    kind: str,
    formulas: Sequence[str],
    used: Iterable[Number],
    carries: str,
    per_axis: bool = False,
) -> list[str]:
    """Return the lines of the comment, without comment signs.

    Parameters
    ----------
    numbers
        The report and the user's choices.
    title
        The file and its consumer.
    kind
        Continuous or discrete, in words.
    formulas
        How each value follows from the coefficients; N, K and f are explained beside them.
    used
        The numbers in the file, for what is a bound.
    carries
        Symbols of the terms the format has a place for.
    per_axis
        Whether the format holds a number for each axis.
    """
    report = numbers.report
    topics = f", {', '.join(report.source.topics)}" if report.source.message_types else ""
    lines = [
        f"{title}, written by imucal {report.version}",
        f"source log: {report.source.path} ({report.source.format}{topics})",
        *(_sensor_line(numbers, sensor) for sensor in Sensor if _has(numbers, sensor)),
        f"kind: {kind}",
        *(f"formula: {formula}" for formula in formulas),
        f"axes: {_axes(numbers, per_axis=per_axis)}",
        f"inflation: {_inflation(numbers)}",
    ]
    bounds = dict.fromkeys(f"{number.symbol} of {name}" for number in used for name in number.bounded)
    if bounds:
        level = report.axes[0].fit.level
        lines.append(f"not identified, so the {level:.0%} upper bound is written: {', '.join(bounds)}")
    if _rates_differ(numbers):
        lines.append("the rates differ: f is each sensor's own; a single rate in the file is the gyroscope's")
    lines += _left_out(report.axes, carries)
    return lines + _warnings(numbers)


def _has(numbers: Numbers, sensor: Sensor) -> bool:
    return any(axis.sensor is sensor for axis in numbers.report.axes)


def _rates_differ(numbers: Numbers) -> bool:
    """Return whether both sensors are there and their rates are more than 0.1 % apart."""
    rates = [numbers.rate_hz(sensor) for sensor in Sensor if _has(numbers, sensor)]
    return max(rates) > 1.001 * min(rates)


def _sensor_line(numbers: Numbers, sensor: Sensor) -> str:
    axis = numbers.axes(sensor)[0]
    given = any(finding.code == "rate-given" for finding in (*numbers.report.findings, *axis.findings))
    origin = "given by the user" if given else "measured"
    return f"{sensor}: f = {numbers.rate_hz(sensor):.9g} Hz ({origin}), {axis.duration_s:.6g} s recorded"


def _axes(numbers: Numbers, *, per_axis: bool) -> str:
    if per_axis:
        return "each its own number; this format needs no axis policy"
    policy = numbers.choices.axis_policy
    return _POLICIES.get(policy, f"{policy} alone")


def _inflation(numbers: Numbers) -> str:
    asked = {name: factor for name, factor in numbers.choices.inflate.items() if factor != 1}
    if not asked:
        return "none; the numbers are those of the sensor at rest"
    parts = (f"{name} ({'/'.join(INFLATABLE[name])}) x {factor:g}" for name, factor in asked.items())
    return f"{', '.join(parts)}; ALREADY in the numbers below"


def _left_out(axes: Iterable[AxisReport], carries: str) -> list[str]:
    """Name the terms that were found but have no place in the format, and the walk that GM looks like."""
    places: dict[str, list[str]] = {}
    walks = []
    for axis in axes:
        for estimate in axis.fit.estimates:
            if estimate.value is None or estimate.symbol in carries.split():
                continue
            places.setdefault(estimate.symbol, []).append(axis.name)
            if estimate.correlation_time is not None:
                time = estimate.correlation_time.value
                walk = estimate.value * math.sqrt(2 / time)
                walks.append(f"{estimate.key} of {axis.name} looks like K = {walk:.3g} below {time:.3g} s")
    if not places:
        return []
    parts = (f"{symbol} ({', '.join(dict.fromkeys(names))})" for symbol, names in places.items())
    return [f"found, but without a place in this format: {', '.join(parts)}", *walks]


def _warnings(numbers: Numbers) -> list[str]:
    report = numbers.report
    findings = [*report.findings, *(finding for axis in report.axes for finding in axis.findings)]
    serious = dict.fromkeys(finding.code for finding in findings if finding.level != "info")
    if not serious:
        return []
    return [f"read the report before you use these numbers; it warns of: {', '.join(serious)}"]

"""check: a report against limits -> verdicts."""

import math
from collections.abc import Iterator
from itertools import chain

from imucal.checking.limits import LOG_QUANTITIES, Baseline, Limit, Limits
from imucal.checking.verdict import CheckResult, Measured, Row, judge
from imucal.errors import LimitsError
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.json_file import load
from imucal.report.result import AxisReport, Report


def check(report: Report, limits: Limits, *, baseline: Report | None = None) -> CheckResult:
    """Judge a report.

    Parameters
    ----------
    report
        What was found.
    limits
        What is allowed; `read_limits` reads them from a file.
    baseline
        An older report to compare with, for limits with a baseline; None loads the one they name.

    Returns
    -------
    CheckResult
        A row for each limit and axis, and for each forbidden finding.

    Raises
    ------
    LimitsError
        If the limits ask for a baseline, and neither they nor the caller name one.
    ReadError
        If the baseline that the limits name can't be read.
    """
    rows = [
        *_axes_there(report, limits),
        *chain.from_iterable(_limit(report, limit) for limit in limits.limits),
        *_findings(report, limits),
    ]
    if limits.baseline is not None:
        rows += _baseline(report, baseline or _older(limits.baseline), limits.baseline)
    return CheckResult(
        source=report.source.path,
        level=report.axes[0].fit.level if report.axes else 0.95,
        rows=tuple(rows),
        undecided_fails=limits.undecided == "fail",
        version=report.version,
        noise=report.verdict,
    )


def _older(rules: Baseline) -> Report:
    if rules.report is None:
        msg = "the limits have a baseline, but no older report was given; name one in the limits file"
        raise LimitsError(msg)
    return load(rules.report)


def _axes_there(report: Report, limits: Limits) -> Iterator[Row]:
    """Fail for an axis that is asked for and missing, so that nothing passes by not being there."""
    there = {axis.name for axis in report.axes}
    found = ", ".join(axis.name for axis in report.axes) or "none"
    for name in dict.fromkeys(_wanted(report, limits)):
        if name not in there:
            yield _fails(name, "axes", f"{name}: the report has no such axis; found {found}")
    for name in dict.fromkeys(limit.where for limit in limits.limits):
        if "_" not in name and not _axes_of(report, name):
            where = Sensor(name).short if name in tuple(Sensor) else name
            yield _fails(where, "axes", f"{name}: the report has no axis of it; found {found}")
    for sensor, axes in limits.required.items():
        asked = {f"{sensor.short}_{axis}" for axis in axes}
        if asked <= there:
            text = f"{sensor}: {', '.join(sorted(asked))} are there"
            yield Row(where=sensor.short, subject="axes", verdict="pass", text=text)


def _wanted(report: Report, limits: Limits) -> Iterator[str]:
    """Yield the axes that are required, that have limits, or that an error speaks of."""
    for sensor, axes in limits.required.items():
        yield from (f"{sensor.short}_{axis}" for axis in axes)
    sections = {limit.where: None for limit in limits.limits}
    yield from (where for where in sections if "_" in where)
    prefixes = tuple(f"{sensor.short}_" for sensor in Sensor if sensor in sections)
    for finding in report.all_findings:
        # A finding may also be about a sensor as a whole.
        if finding.level == "error" and (finding.axis or "").startswith(prefixes):
            yield finding.axis or ""


def _axes_of(report: Report, where: str) -> tuple[AxisReport, ...]:
    """Return the axes that ``log``, a sensor or an axis name stands for."""
    return tuple(axis for axis in report.axes if where in ("log", axis.sensor, axis.name))


def _limit(report: Report, limit: Limit) -> Iterator[Row]:
    by_sensor: dict[Sensor, list[AxisReport]] = {}
    for axis in _axes_of(report, limit.where):
        by_sensor.setdefault(axis.sensor, []).append(axis)
    for sensor, axes in by_sensor.items():
        # A quantity of the clock is most often one for all axes, and said once.
        clock = limit.quantity in LOG_QUANTITIES and len(axes) > 1
        if clock and len({measure(axis, limit.quantity) for axis in axes}) == 1:
            yield from _axis_limit(axes[0], sensor.short, limit)
            continue
        for axis in axes:
            yield from _axis_limit(axis, axis.name, limit)


def _axis_limit(axis: AxisReport, where: str, limit: Limit) -> Iterator[Row]:
    for key, value in measure(axis, limit.quantity) or ((limit.quantity, None),):
        scaled = None if value is None else value.scaled(1 / limit.factor)
        yield judge(where, key, scaled, side=limit.side, limit=limit.value, unit=limit.unit)


def _findings(report: Report, limits: Limits) -> Iterator[Row]:
    rules, found = limits.findings, dict.fromkeys(report.all_findings)
    forbidden = [finding for finding in found if rules.forbids(finding.level, finding.code)]
    for finding in forbidden:
        where = finding.axis or "log"
        text = f"{where}: forbidden {finding.level} [{finding.code}]: {finding.text}"
        yield _fails(where, finding.code, text)
    if not forbidden and (rules.level != "none" or rules.forbid):
        yield Row(where="log", subject="findings", verdict="pass", text="log: no forbidden finding")


def _baseline(report: Report, before: Report, rules: Baseline) -> Iterator[Row]:
    there = {axis.name: axis for axis in report.axes}
    for old in before.axes:
        if old.name not in there:
            yield _fails(old.name, "axes", f"{old.name}: in the baseline, but not in the report")
            continue
        for symbol in rules.terms:
            yield from _changes(there[old.name], old, symbol, rules)


def _changes(now: AxisReport, before: AxisReport, symbol: str, rules: Baseline) -> Iterator[Row]:
    old, same = dict(measure(before, symbol)), _same_fit(now, before)
    for key, measured in measure(now, symbol):
        if key not in old:
            text = f"{now.name}: {key} is not in the baseline's model"
            yield Row(where=now.name, subject=f"{key} / baseline", verdict="undecided", text=text)
            continue
        ratio = Measured.exactly(1.0) if same else relative(measured, old[key])
        subject = f"{key} / baseline"
        if rules.max_increase is not None:
            yield judge(now.name, subject, ratio, side="max", limit=1 + rules.max_increase)
        if rules.max_decrease is not None:
            yield judge(now.name, subject, ratio, side="min", limit=1 - rules.max_decrease)


def _same_fit(now: AxisReport, before: AxisReport) -> bool:
    """Say whether two results are one: no noise is between them, so that a ratio is 1 without an interval."""
    samples = [(axis.samples, axis.rate_hz, axis.mean, axis.std) for axis in (now, before)]
    # Text, because limits that are not known are NaN, which no NaN equals.
    return samples[0] == samples[1] and repr(now.fit.estimates) == repr(before.fit.estimates)


def measure(axis: AxisReport, quantity: str) -> tuple[tuple[str, Measured], ...]:
    """Return a quantity of an axis in SI, under its name; several for several Gauss-Markov terms."""
    missing = sum(gap.missing for gap in axis.gaps)
    exact = {
        "rate": axis.rate_hz,
        "duration": axis.duration_s,
        "gaps": float(len(axis.gaps)),
        "missing": missing / (axis.samples + missing) if missing else 0.0,
        "mean": axis.mean,
        "std": axis.std,
    }
    if quantity in exact:
        return ((quantity, Measured.exactly(exact[quantity])),)
    if quantity == "minimum":
        lowest = numbers.minimum(axis.fit)
        return ((quantity, Measured(value=lowest.value, low=lowest.low, high=lowest.high)),)
    return tuple(
        (estimate.key, Measured(value=estimate.value, low=estimate.low, high=estimate.high))
        for estimate in axis.fit.estimates
        if estimate.symbol == quantity
    )


def relative(now: Measured, before: Measured) -> Measured:
    """Return the ratio of two independent quantities with its interval.

    The distances to the limits of both add in quadrature on the logarithmic scale (Zou & Donner
    2008, the MOVER method). A bound is between 0 and its upper limit.
    """
    if now.value is None or before.value is None:
        low = now.low / before.high if before.high else math.inf
        high = now.high / before.low if before.low else math.inf
        return Measured(value=None, low=low, high=high)
    ratio = now.value / before.value if before.value else math.inf
    down = math.hypot(_distance(now.low, now.value), _distance(before.value, before.high))
    up = math.hypot(_distance(now.value, now.high), _distance(before.low, before.value))
    return Measured(
        value=ratio, low=ratio * math.exp(-down), high=ratio * (math.exp(up) if up < 700 else math.inf)
    )


def _distance(low: float, high: float) -> float:
    return math.log(high / low) if low > 0 else math.inf


def _fails(where: str, subject: str, text: str) -> Row:
    return Row(where=where, subject=subject, verdict="fail", text=text)

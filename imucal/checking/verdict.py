"""check: a report against limits -> verdicts, by the interval and not by the value.

pass or fail: the whole interval is within or beyond the limit; undecided: it contains the limit.
"""

from collections.abc import Iterable, Iterator
from dataclasses import KW_ONLY, asdict, dataclass
from itertools import chain
from typing import Literal, TypeAlias

from imucal.checking.ci_files import Case, Outcome
from imucal.checking.limits import (
    LOG_QUANTITIES,
    Baseline,
    FindingRules,
    Limit,
    Limits,
    Side,
)
from imucal.comparison import paired, ratio
from imucal.errors import Fix, LimitsError
from imucal.findings import Finding
from imucal.grading import NoiseVerdict
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.json_file import load
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report
from imucal.report.typed_json import picked

Verdict: TypeAlias = Literal["pass", "fail", "undecided"]
WORST_FIRST: tuple[Verdict, ...] = ("fail", "undecided", "pass")


#: Most rows in a short text.
_SHOWN = 10


@dataclass(frozen=True)
class Row:
    """One verdict on an axis, a sensor or the ``log``, and what was `found` there.

    `side` and `limit` are None if the rule is not a number; `measured`, in the same unit, is None if nothing
    was measured. `instead` replaces a wrong or doubtful line of a config file. A table prints `found` of a
    row `in_words`, because its number alone explains nothing.
    """

    where: str
    subject: str
    verdict: Verdict
    found: str
    _: KW_ONLY
    side: Side | None = None
    limit: float | None = None
    unit: str = ""
    measured: Quantity | None = None
    instead: str = ""
    in_words: bool = False

    @property
    def text(self) -> str:
        """The sentence ``gyro_x: N is …; above the largest allowed, …``, and a better line."""
        advice = f"; write '{self.instead}'" if self.instead else ""
        return f"{self.where}: {self.found}{advice}"

    @property
    def rule(self) -> str:
        """The limit as text, such as ``N <= 0.3 deg/sqrt(h)``."""
        if self.limit is None:
            return self.subject
        return f"{self.subject} {'<=' if self.side == 'max' else '>='} {self.limit:.6g} {self.unit}".rstrip()


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """The result of a check of a report: a row for each limit and axis.

    `level` is the confidence level of the intervals. An undecided limit fails the check if `undecided_fails`.
    """

    source: str
    level: float
    rows: tuple[Row, ...]
    undecided_fails: bool
    version: str
    noise: NoiseVerdict

    def __repr__(self) -> str:
        counts = ", ".join(f"{self.count(verdict)} {verdict}" for verdict in WORST_FIRST)
        wrong = [row.text for row in self.rows if row.verdict != "pass"]
        return "\n".join([f"Check of {self.source}: {counts}", *wrong[:_SHOWN]])

    @property
    def verdict(self) -> Verdict:
        return min((row.verdict for row in self.rows), key=WORST_FIRST.index, default="pass")

    @property
    def passed(self) -> bool:
        return not any(self.fails(row) for row in self.rows)

    def fails(self, row: Row) -> bool:
        return row.verdict == "fail" or (row.verdict == "undecided" and self.undecided_fails)

    def count(self, verdict: Verdict) -> int:
        return sum(row.verdict == verdict for row in self.rows)


def judge(
    where: str, subject: str, measured: Quantity | None, *, side: Side, limit: float, unit: str = ""
) -> Row:
    """Return the verdict on one limit; `measured` has the same unit, or is None if the model lacks it."""
    verdict: Verdict = "undecided"
    if measured is None:
        found = f"the model has no {subject} and no bound for it; fit a model with it, or remove the limit"
    else:
        most, beyond, up = ("largest", "above", 1) if side == "max" else ("smallest", "below", -1)
        allowed = f"the {most} allowed, {limit:.6g}"
        message = f"the interval contains {allowed}; record for longer to decide"
        near, far = (measured.low, measured.high)[::up]
        if up * far <= up * limit:
            verdict, message = "pass", f"not {beyond} {allowed}"
        elif up * near > up * limit:
            verdict, message = "fail", f"{beyond} {allowed}"
        shown = f"{'not detected, but ' * (measured.value is None)}{measured.text()} {unit}".rstrip()
        found = f"{subject} is {shown}; {message}"
    return Row(where, subject, verdict, found, side=side, limit=limit, unit=unit, measured=measured)


def check(report: Report, limits: Limits, *, baseline: Report | None = None) -> CheckResult:
    """Judge a report: a row for each limit and axis, and for each forbidden finding.

    `baseline` replaces the older report in the limits. Raises LimitsError if a baseline is missing, or if all
    limits are for a calibration; ReadError if the older report can't be read.
    """
    if limits.calibration and not are_of_noise(limits):
        advice = (
            "write limits such as [gyroscope] N = { max = 1e-4 }, or check the folder of 'imucal calibrate'"
        )
        problem = "this is a noise report, and the limits are for a calibration"
        raise LimitsError(problem, place=report.source.path, fix=Fix(advice))
    rows = [
        *_axes_there(report, limits),
        *chain.from_iterable(_limit(report, limit) for limit in limits.limits),
        *finding_rows(report.all_findings, limits.findings),
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


def are_of_noise(limits: Limits) -> bool:
    """Return whether some limits are for a noise report."""
    return bool(limits.limits or limits.required or limits.baseline)


def _older(rules: Baseline) -> Report:
    if rules.report is None:
        msg = "the limits have a baseline without a report; name one in the limits file"
        raise LimitsError(msg)
    return load(rules.report)


def _axes_there(report: Report, limits: Limits) -> Iterator[Row]:
    there = {axis.name for axis in report.axes}
    found = ", ".join(axis.name for axis in report.axes) or "none"
    for name in dict.fromkeys(_wanted(report, limits)):
        if name not in there:
            yield Row(name, "axes", "fail", f"the report has no such axis; found {found}")
    for name in dict.fromkeys(limit.where for limit in limits.limits):
        if "_" not in name and not _axes_of(report, name):
            where = Sensor(name).short if name in tuple(Sensor) else name
            yield Row(where, "axes", "fail", f"the report has no axis of this sensor; found {found}")
    for sensor, axes in limits.required.items():
        asked = {f"{sensor.short}_{axis}" for axis in axes}
        if asked <= there:
            yield Row(sensor.short, "axes", "pass", f"{', '.join(sorted(asked))} are present")


def _wanted(report: Report, limits: Limits) -> Iterator[str]:
    """Yield the axes that are required, have limits, or are named in an error."""
    for sensor, axes in limits.required.items():
        yield from (f"{sensor.short}_{axis}" for axis in axes)
    sections = {limit.where: None for limit in limits.limits}
    yield from (where for where in sections if "_" in where)
    prefixes = tuple(f"{sensor.short}_" for sensor in Sensor if sensor in sections)
    for finding in report.all_findings:
        if finding.level == "error" and (finding.axis or "").startswith(prefixes):
            yield finding.axis or ""


def _axes_of(report: Report, where: str) -> tuple[AxisReport, ...]:
    return tuple(axis for axis in report.axes if where in ("log", axis.sensor, axis.name))


def _limit(report: Report, limit: Limit) -> Iterator[Row]:
    by_sensor: dict[Sensor, list[AxisReport]] = {}
    for axis in _axes_of(report, limit.where):
        by_sensor.setdefault(axis.sensor, []).append(axis)
    for sensor, axes in by_sensor.items():
        # A quantity of the clock is usually the same for all axes: report it once.
        clock = limit.quantity in LOG_QUANTITIES and len(axes) > 1
        if clock and len({measure(axis, limit.quantity) for axis in axes}) == 1:
            yield from _axis_limit(axes[0], sensor.short, limit)
            continue
        for axis in axes:
            yield from _axis_limit(axis, axis.name, limit)


def _axis_limit(axis: AxisReport, where: str, limit: Limit) -> Iterator[Row]:
    for key, value in measure(axis, limit.quantity) or ((limit.quantity, None),):
        scaled = None if value is None else value.scaled(1 / limit.factor, limit.unit)
        yield judge(where, key, scaled, side=limit.side, limit=limit.value, unit=limit.unit)


def finding_rows(findings: Iterable[Finding], rules: FindingRules) -> Iterator[Row]:
    """Yield a failure for each forbidden finding, or one pass if there is none."""
    found = dict.fromkeys(findings)
    forbidden = [finding for finding in found if rules.forbids(finding.level, finding.code)]
    for finding in forbidden:
        where = finding.axis or "log"
        text = f"forbidden {finding.level} [{finding.code}]: {finding.text}"
        yield Row(where, finding.code, "fail", text)
    if not forbidden and (rules.level != "none" or rules.forbid):
        yield Row("log", "findings", "pass", "no forbidden finding")


def _baseline(report: Report, before: Report, rules: Baseline) -> Iterator[Row]:
    there = {axis.name: axis for axis in report.axes}
    for old in before.axes:
        if old.name not in there:
            yield Row(old.name, "axes", "fail", "in the baseline, but not in the report")
            continue
        yield from _changes(there[old.name], old, rules)


def _changes(now: AxisReport, before: AxisReport, rules: Baseline) -> Iterator[Row]:
    same = _same_fit(now, before)
    for key, old, new in paired(before, now):
        if new is None or key not in {each.key for each in now.fit.estimates if each.symbol in rules.terms}:
            continue
        subject = f"{key} / baseline"
        if old is None:
            yield Row(now.name, subject, "undecided", f"the baseline's model has no {key}")
            continue
        change = (
            Quantity.exactly(1.0) if same else ratio(numbers.si(new, now.sensor), numbers.si(old, now.sensor))
        )
        if rules.max_increase is not None:
            yield judge(now.name, subject, change, side="max", limit=1 + rules.max_increase)
        if rules.max_decrease is not None:
            yield judge(now.name, subject, change, side="min", limit=1 - rules.max_decrease)


def _same_fit(now: AxisReport, before: AxisReport) -> bool:
    """Return whether two results are of the same samples: then the ratio is 1 without an interval."""
    samples = [(axis.samples, axis.rate_hz, axis.mean, axis.std) for axis in (now, before)]
    # Compare as text, because unknown limits are NaN.
    return samples[0] == samples[1] and _digits(now) == _digits(before)


def _digits(axis: AxisReport) -> str:
    return repr([asdict(estimate) for estimate in axis.fit.estimates])


def measure(axis: AxisReport, quantity: str) -> tuple[tuple[str, Quantity], ...]:
    """Return a quantity of an axis in SI with its name; several for several Gauss-Markov terms."""
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
        return ((quantity, Quantity.exactly(exact[quantity])),)
    if quantity == "minimum":
        return ((quantity, numbers.minimum(axis.fit)),)
    own = (estimate for estimate in axis.fit.estimates if estimate.symbol == quantity)
    return tuple((estimate.key, numbers.si(estimate, axis.sensor)) for estimate in own)


SCHEMA = "imucal/checking/1"
_MEASURED = "value low high"


def to_document(result: CheckResult) -> dict[str, object]:
    """Return the verdicts as JSON values; an infinite limit is null."""
    return {
        "schema": SCHEMA,
        **picked(result, "version source level verdict passed"),
        "noise": picked(result.noise, "verdict=grade sentence"),
        "counts": {name: result.count(name) for name in ("pass", "fail", "undecided")},
        "rows": [
            {
                **picked(row, "where subject side limit unit"),
                **(picked(row.measured, _MEASURED) if row.measured else dict.fromkeys(_MEASURED.split())),
                **picked(row, "verdict text"),
                "instead": row.instead or None,
            }
            for row in result.rows
        ],
    }


def cases_of(result: CheckResult) -> tuple[Case, ...]:
    """Return a case for each row; an undecided row is skipped unless it fails the check."""
    cases = []
    for row in result.rows:
        outcome: Outcome = "pass" if row.verdict == "pass" else "skip"
        if result.fails(row):
            outcome = "fail"
        cases.append(Case(where=row.where, rule=row.rule, text=row.text, outcome=outcome, kind=row.verdict))
    return tuple(cases)

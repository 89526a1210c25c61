"""Verdicts: a limit passes or fails by the interval, not by the point.

pass: the whole interval is within the limit; fail: the whole interval is beyond it; undecided: the
limit lies inside the interval, so that the record can't tell. Machines read the verdicts as JSON, as
JUnit XML, or as GitHub's workflow commands.
"""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias
from xml.etree import ElementTree as ET

from imucal.grading import NoiseVerdict
from imucal.report.json_file import plain

Verdict: TypeAlias = Literal["pass", "fail", "undecided"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A quantity and its interval, in one unit; `value` is None for a bounded term.

    A quantity without an interval (a rate, a count) has ``low == value == high``.
    """

    value: float | None
    low: float
    high: float

    @classmethod
    def exactly(cls, value: float) -> "Measured":
        """Return a quantity without an interval."""
        return cls(value=value, low=value, high=value)

    def scaled(self, factor: float) -> "Measured":
        """Return it in another unit."""
        value = None if self.value is None else self.value * factor
        return Measured(value=value, low=self.low * factor, high=self.high * factor)

    def text(self) -> str:
        """Return ``0.41 [0.4, 0.42]``, ``<= 0.2`` for a bound, or a number alone."""
        if self.value is not None and self.low == self.high:
            return f"{self.value:.6g}"
        if self.value is not None:
            return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}]"
        if math.isinf(self.high) and self.low == 0:
            return "unknown"
        if math.isinf(self.high):
            return f">= {self.low:.4g}"
        return f"[{self.low:.4g}, {self.high:.4g}]" if self.low > 0 else f"<= {self.high:.4g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One verdict.

    Attributes
    ----------
    where
        Axis, sensor or ``log``.
    subject
        What was judged: a symbol, a quantity, ``axes``, ``findings``, ``N / baseline``.
    side, limit, unit
        ``min`` or ``max`` and the limit in its unit; None where the rule isn't a number.
    measured
        In the same unit; None where there is nothing to measure.
    verdict
        ``pass``, ``fail`` or ``undecided``.
    text
        One sentence.
    instead
        The line to write in place of one of a config file that is wrong or doubtful; empty elsewhere.
    """

    where: str
    subject: str
    verdict: Verdict
    text: str
    side: Literal["min", "max"] | None = None
    limit: float | None = None
    unit: str = ""
    measured: Measured | None = None
    instead: str = ""

    @property
    def rule(self) -> str:
        """The limit in words, such as ``N <= 0.3 deg/sqrt(h)``."""
        if self.limit is None:
            return self.subject
        return f"{self.subject} {'<=' if self.side == 'max' else '>='} {self.limit:.6g} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """What came of a check.

    Attributes
    ----------
    source
        The log the report is about.
    level
        Confidence level of the intervals.
    rows
        One a limit and axis.
    undecided_fails
        Whether an undecided limit fails the check.
    version
        imucal's version.
    noise
        What the report says of the recording: good, look or not-noise.
    """

    source: str
    level: float
    rows: tuple[Row, ...]
    undecided_fails: bool
    version: str
    noise: NoiseVerdict

    @property
    def verdict(self) -> Verdict:
        """``fail`` where a row failed; else ``undecided`` where one is; else ``pass``."""
        found = {row.verdict for row in self.rows}
        return "fail" if "fail" in found else "undecided" if "undecided" in found else "pass"

    @property
    def passed(self) -> bool:
        """Whether the gate opens."""
        return not any(self.fails(row) for row in self.rows)

    def fails(self, row: Row) -> bool:
        """Return whether a row closes the gate."""
        return row.verdict == "fail" or (row.verdict == "undecided" and self.undecided_fails)

    def count(self, verdict: Verdict) -> int:
        """Return how many rows have a verdict."""
        return sum(row.verdict == verdict for row in self.rows)


def judge(
    where: str,
    subject: str,
    measured: Measured | None,
    *,
    side: Literal["min", "max"],
    limit: float,
    unit: str = "",
) -> Row:
    """Return the verdict on one limit, in `unit` as `measured` is; that is None of what the model lacks."""
    verdict: Verdict = "undecided"
    if measured is None:
        text = f"the model has no {subject}, and no bound on it; fit a model with it, or remove the limit"
    else:
        inside, outside = measured.high <= limit, measured.low > limit
        if side == "min":
            inside, outside = measured.low >= limit, measured.high < limit
        verdict = "pass" if inside else "fail" if outside else "undecided"
        beyond, most = ("above", "largest") if side == "max" else ("below", "smallest")
        shown = f"{'not identified, but ' * (measured.value is None)}{measured.text()} {unit}".rstrip()
        allowed = f"the {most} allowed, {limit:.6g}"
        said = {
            "pass": f"not {beyond} {allowed}",
            "fail": f"{beyond} {allowed}",
            "undecided": f"the interval holds {allowed}; record for longer to decide",
        }
        text = f"{subject} is {shown}; {said[verdict]}"
    return Row(
        where=where,
        subject=subject,
        side=side,
        limit=limit,
        unit=unit,
        measured=measured,
        verdict=verdict,
        text=f"{where}: {text}",
    )


SCHEMA = "imucal/checking/1"
_MEASURED = ("value", "low", "high")


def to_document(result: CheckResult) -> dict[str, object]:
    """Return the verdicts as JSON values; an infinite limit of an interval is null."""
    return {
        "schema": SCHEMA,
        "version": result.version,
        "source": result.source,
        "level": result.level,
        "verdict": result.verdict,
        "passed": result.passed,
        "noise": {"verdict": result.noise.grade, "sentence": result.noise.sentence},
        "counts": {name: result.count(name) for name in ("pass", "fail", "undecided")},
        "rows": [
            {
                **{name: getattr(row, name) for name in ("where", "subject", "side", "limit", "unit")},
                **{name: row.measured and plain(getattr(row.measured, name)) for name in _MEASURED},
                "verdict": row.verdict,
                "text": row.text,
                "instead": row.instead or None,
            }
            for row in result.rows
        ],
    }


def junit_xml(result: CheckResult) -> str:
    """Return JUnit XML: one case a row; an undecided one is skipped unless it fails the check.

    Source: the JUnit schema that GitLab, Jenkins and the GitHub report actions read.
    """
    failures = sum(result.fails(row) for row in result.rows)
    skipped = 0 if result.undecided_fails else result.count("undecided")
    numbers = {"tests": len(result.rows), "failures": failures, "errors": 0, "skipped": skipped}
    counts = {name: str(number) for name, number in numbers.items()}
    root = ET.Element("testsuites", {"name": "imucal check", **counts})
    suite = ET.SubElement(root, "testsuite", {"name": _xml_text(result.source), **counts})
    for row in result.rows:
        rule, text = _xml_text(row.rule), _xml_text(row.text)
        case = ET.SubElement(suite, "testcase", classname=f"imucal.{row.where}", name=rule, time="0")
        if result.fails(row):
            ET.SubElement(case, "failure", message=text, type=row.verdict).text = text
        elif row.verdict == "undecided":
            ET.SubElement(case, "skipped", message=text)
        else:
            ET.SubElement(case, "system-out").text = text
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def github_annotations(result: CheckResult, *, file: str = "") -> tuple[str, ...]:
    """Return a workflow command for each row that failed or is undecided; `file` is the limits file.

    Source: GitHub Actions documentation, "Workflow commands", and actions/toolkit (the escapes).
    """
    lines = []
    for row in result.rows:
        if row.verdict == "pass":
            continue
        command = "error" if result.fails(row) else "warning"
        place = f"file={_property(file)}," if file else ""
        title = _property(f"imucal {row.where}: {row.rule}")
        lines.append(f"::{command} {place}title={title}::{_data(row.text)}")
    return tuple(lines)


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


def _xml_text(text: str) -> str:
    """XML has no place for control characters."""
    return "".join(sign if sign.isprintable() else " " for sign in text)

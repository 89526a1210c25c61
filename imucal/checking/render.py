"""Verdicts as machines read them: JSON, JUnit XML, GitHub's workflow commands."""

from xml.etree import ElementTree as ET

from imucal.checking.verdict import CheckResult, Row
from imucal.report.json_file import plain

SCHEMA = "imucal/checking/1"


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
        "rows": [_row(row) for row in result.rows],
    }


def junit_xml(result: CheckResult) -> str:
    """Return JUnit XML: one case a row; an undecided one is skipped unless it fails the check.

    Source: the JUnit schema that GitLab, Jenkins and the GitHub report actions read.
    """
    failures = sum(result.fails(row) for row in result.rows)
    skipped = sum(row.verdict == "undecided" and not result.fails(row) for row in result.rows)
    counts = {
        "tests": str(len(result.rows)),
        "failures": str(failures),
        "errors": "0",
        "skipped": str(skipped),
    }
    root = ET.Element("testsuites", {"name": "imucal check", **counts})
    suite = ET.SubElement(root, "testsuite", {"name": _xml_text(result.source), **counts})
    for row in result.rows:
        case = ET.SubElement(
            suite, "testcase", classname=f"imucal.{row.where}", name=_xml_text(row.rule), time="0"
        )
        if result.fails(row):
            ET.SubElement(case, "failure", message=_xml_text(row.text), type=row.verdict).text = _xml_text(
                row.text
            )
        elif row.verdict == "undecided":
            ET.SubElement(case, "skipped", message=_xml_text(row.text))
        else:
            ET.SubElement(case, "system-out").text = _xml_text(row.text)
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


def _row(row: Row) -> dict[str, object]:
    measured = row.measured
    return {
        "where": row.where,
        "subject": row.subject,
        "side": row.side,
        "limit": row.limit,
        "unit": row.unit,
        "value": measured and plain(measured.value),
        "low": measured and plain(measured.low),
        "high": measured and plain(measured.high),
        "verdict": row.verdict,
        "text": row.text,
    }


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


def _xml_text(text: str) -> str:
    """XML has no place for control characters."""
    return "".join(sign if sign.isprintable() else " " for sign in text)

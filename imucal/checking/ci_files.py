"""Verdicts in the forms that continuous integration reads: JUnit XML, and annotations of GitHub."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias
from xml.etree import ElementTree as ET

from imucal.printable import one_line

__all__ = ["Case", "Outcome", "github_annotations", "junit_xml"]

#: skip: the case did not fail, and nobody knows whether it passes.
Outcome: TypeAlias = Literal["pass", "fail", "skip"]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One verdict: `where` and by which `rule`, with its sentence; `kind` is the command's own word."""

    where: str
    rule: str
    text: str
    outcome: Outcome
    kind: str


def junit_xml(command: str, source: str, cases: Sequence[Case]) -> str:
    """Return JUnit XML.

    Source: the JUnit schema that GitLab, Jenkins and the GitHub report actions read.
    """
    outcomes = [case.outcome for case in cases]
    numbers = {
        "tests": len(cases),
        "failures": outcomes.count("fail"),
        "errors": 0,
        "skipped": outcomes.count("skip"),
    }
    counts = {name: str(number) for name, number in numbers.items()}
    root = ET.Element("testsuites", {"name": command, **counts})
    suite = ET.SubElement(root, "testsuite", {"name": one_line(source), **counts})
    for case in cases:
        text = one_line(case.text)
        name = one_line(case.rule)
        element = ET.SubElement(suite, "testcase", classname=f"imucal.{case.where}", name=name, time="0")
        if case.outcome == "fail":
            ET.SubElement(element, "failure", message=text, type=case.kind).text = text
        elif case.outcome == "skip":
            ET.SubElement(element, "skipped", message=text)
        else:
            ET.SubElement(element, "system-out").text = text
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def github_annotations(cases: Sequence[Case], *, file: str = "") -> tuple[str, ...]:
    """Return a workflow command for each case that did not pass; `file` is the file that it belongs to.

    Source: GitHub Actions documentation, "Workflow commands", and actions/toolkit (the escapes).
    """
    lines = []
    for case in cases:
        if case.outcome == "pass":
            continue
        command = "error" if case.outcome == "fail" else "warning"
        place = f"file={_property(file)}," if file else ""
        title = _property(f"imucal {case.where}: {case.rule}")
        lines.append(f"::{command} {place}title={title}::{_data(case.text)}")
    return tuple(lines)


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")

"""Verdicts in machine-readable form: JSON, JUnit XML, GitHub annotations."""

import json
from dataclasses import replace

from lxml import etree

from imucal.checking import CheckResult, check, parse_limits
from imucal.checking.ci_files import github_annotations, junit_xml
from imucal.checking.verdict import cases_of, to_document
from imucal.recording import Source
from tests.report.synthetic import consumer_report

LIMITS = """
[gyroscope]
K = { max = 1.1e-6 }
N = { max = 1.25e-4 }
[log]
missing = { max = 0.1, unit = "%" }
"""


def _result(*, undecided: str = "pass", path: str = "a.mcap") -> CheckResult:
    report = replace(consumer_report(), source=Source(path=path, format="mcap"))
    return check(report, parse_limits(f'undecided = "{undecided}"\n{LIMITS}'))


def test_json_contains_every_number() -> None:
    """The document is strict JSON."""
    document = json.loads(json.dumps(to_document(_result()), allow_nan=False))
    assert document["schema"] == "imucal/checking/1"
    assert (document["verdict"], document["passed"]) == ("fail", False)
    assert document["noise"]["verdict"] == "check"
    assert document["noise"]["sentence"].startswith("Check first: ")
    assert document["counts"] == {"pass": 6, "fail": 2, "undecided": 1}
    row = next(row for row in document["rows"] if row["verdict"] == "undecided")
    assert (row["where"], row["subject"], row["side"], row["limit"]) == ("gyro_x", "K", "max", 1.1e-6)
    assert row["low"] < row["limit"] < row["high"]


def test_an_unknown_interval_is_null() -> None:
    """The ratio of two bounds can be anything, and JSON has no infinity."""
    other = consumer_report()
    other = replace(other, axes=tuple(replace(axis, mean=1.0) for axis in other.axes))
    result = check(consumer_report(), parse_limits("[baseline]\nterms = ['K']"), baseline=other)
    document = json.loads(json.dumps(to_document(result), allow_nan=False))
    row = next(row for row in document["rows"] if row["where"] == "gyro_y")
    assert (row["low"], row["high"], row["verdict"]) == (0, None, "undecided")


def xml_of(result: CheckResult) -> str:
    """Return the JUnit XML of a check."""
    return junit_xml("imucal check", result.source, cases_of(result))


def test_junit_has_a_case_for_each_row() -> None:
    """An undecided row is skipped, or fails if it fails the check."""
    for undecided, failures, skipped in (("pass", 2, 1), ("fail", 3, 0)):
        root = etree.fromstring(xml_of(_result(undecided=undecided)).encode())
        (suite,) = root
        assert len(suite) == int(suite.attrib["tests"]) == 9
        assert len(suite.findall("testcase/failure")) == int(suite.attrib["failures"]) == failures
        assert len(suite.findall("testcase/skipped")) == int(suite.attrib["skipped"]) == skipped
    names = {(case.get("classname"), case.get("name")) for case in suite}
    assert ("imucal.gyro_x", "K <= 1.1e-06 rad/s/sqrt(s)") in names


def test_any_log_name_gives_valid_xml() -> None:
    """The name contains angle brackets and control characters."""
    root = etree.fromstring(xml_of(_result(path='<a>\x00&"b')).encode())
    assert root[0].get("name") == '<a> &"b'


def test_github_annotations_are_escaped() -> None:
    """Per cent, commas and colons would end a property. An undecided row is a warning."""
    lines = github_annotations(cases_of(_result()), file="ci/limits, mine.toml")
    assert len(lines) == 3
    place = "file=ci/limits%2C mine.toml,title=imucal"
    assert lines[0].startswith(f"::error {place} gyro%3A missing <= 0.1 %25::gyro: missing is 1.0989 %25;")
    assert any(line.startswith(f"::warning {place} gyro_x%3A K <= 1.1e-06 ") for line in lines)
    assert all("\n" not in line for line in lines)
    assert github_annotations(cases_of(_result()))[0].startswith("::error title=")

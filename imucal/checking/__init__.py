"""The gate: a report against limits, by the interval and not by the point."""

from imucal.checking.gate import check
from imucal.checking.limits import Baseline, FindingRules, Limit, Limits
from imucal.checking.limits_file import parse_limits, read_limits
from imucal.checking.render import github_annotations, junit_xml, to_document
from imucal.checking.verdict import CheckResult, Measured, Row, Verdict

__all__ = [
    "Baseline",
    "CheckResult",
    "FindingRules",
    "Limit",
    "Limits",
    "Measured",
    "Row",
    "Verdict",
    "check",
    "github_annotations",
    "junit_xml",
    "parse_limits",
    "read_limits",
    "to_document",
]

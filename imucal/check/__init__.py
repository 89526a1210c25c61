"""The gate: a report against limits, by the interval and not by the point."""

from imucal.check.gate import check
from imucal.check.limits import Baseline, FindingRules, Limit, Limits
from imucal.check.limits_file import parse_limits, read_limits
from imucal.check.render import github_annotations, junit_xml, to_document
from imucal.check.verdict import CheckResult, Measured, Row, Verdict

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

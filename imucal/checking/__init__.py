"""The gate: a report against limits, by the interval and not by the point."""

from imucal.checking.config_files import check_config
from imucal.checking.limits import Baseline, FindingRules, Limits, parse_limits, read_limits
from imucal.checking.verdict import CheckResult, check, check_calibration

__all__ = [
    "Baseline",
    "CheckResult",
    "FindingRules",
    "Limits",
    "check",
    "check_calibration",
    "check_config",
    "parse_limits",
    "read_limits",
]

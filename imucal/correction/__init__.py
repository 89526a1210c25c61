"""correction: a calibration and a log -> the corrected log; everything else in the log stays as it is."""

from imucal.correction.rewriting import AppliedLog, apply_to_log

__all__ = ["AppliedLog", "apply_to_log"]

"""Recording of a moving IMU -> diagnosis of its stream: units, axes, clocks, range, samples."""

from imucal.health.diagnosing import diagnose
from imucal.health.diagnosis import Diagnosis, Row, Status

__all__ = ["Diagnosis", "Row", "Status", "diagnose"]

"""Calibration from rests in several attitudes: bias, scale, misalignment and g-sensitivity with intervals."""

__all__ = ["fit_accelerometer", "mean_covariance"]

from imucal.calibration.accelerometer import fit_accelerometer
from imucal.calibration.mean_covariance import mean_covariance

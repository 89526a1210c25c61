"""Calibration from rests in several attitudes: bias, scale, misalignment and g-sensitivity with intervals."""

from imucal.calibration.accelerometer import Suggestion, fit_accelerometer
from imucal.calibration.calibrating import calibrate
from imucal.calibration.mean_covariance import mean_covariance
from imucal.calibration.parameters import Parameter
from imucal.calibration.result import Calibration

__all__ = ["Calibration", "Parameter", "Suggestion", "calibrate", "fit_accelerometer", "mean_covariance"]

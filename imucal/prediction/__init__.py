"""Predictions from fitted models.

From fits this package computes the variances of angle, velocity and position with limits, and the two numbers
for a filter. It also checks whether one half of a record predicts the other.
"""

from imucal.prediction.drift import Drift, DriftOf, DriftPoint, drift
from imucal.prediction.filter_numbers import FilterNumbers, filter_numbers
from imucal.prediction.self_check import half_predictions, self_check

__all__ = [
    "Drift",
    "DriftOf",
    "DriftPoint",
    "FilterNumbers",
    "drift",
    "filter_numbers",
    "half_predictions",
    "self_check",
]

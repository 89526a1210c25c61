"""Predictions from fitted models: drift with limits, two numbers for a filter, and a check by halves."""

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

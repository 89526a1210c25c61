"""Predictions from fitted models: drift with limits, and two numbers for a filter."""

from imucal.prediction.drift import Drift, DriftOf, DriftPoint, drift
from imucal.prediction.filter_numbers import FilterNumbers, filter_numbers

__all__ = [
    "Drift",
    "DriftOf",
    "DriftPoint",
    "FilterNumbers",
    "drift",
    "filter_numbers",
]

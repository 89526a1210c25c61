"""What a fitted model says of the errors that grow when its sensor is integrated.

Fits come in; variances of angle, velocity and position with their limits come out, and the two numbers
that a filter can be held to; and whether one half of a record predicts the other.
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

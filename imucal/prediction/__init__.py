"""What a fitted model says of the errors that grow when its sensor is integrated.

Fits come in; variances of angle, velocity and position with their limits come out, and the two numbers
that a filter can be held to; and whether one half of a record predicts the other.
"""

from imucal.prediction.filter_numbers import FilterNumbers, filter_numbers
from imucal.prediction.self_check import Prediction, half_predictions, self_check

__all__ = ["FilterNumbers", "Prediction", "filter_numbers", "half_predictions", "self_check"]

"""Compare two calibrations of one IMU: each parameter with the p-value of its difference.

The standard deviation of a difference follows from both 95 % intervals. p-values are adjusted for the number
of parameters (Holm 1979). Biases differ between starts, which the intervals of one log do not contain.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from scipy.special import ndtr, ndtri

from imucal.calibration.document import CalibrationDocument
from imucal.calibration.parameters import Parameter
from imucal.errors import DataError, Fix
from imucal.multiple_tests import holm
from imucal.recording import Sensor

__all__ = ["CalibrationDifference", "compare_calibrations"]

#: Normal quantile of a two-sided interval of 95 %.
_Z = float(ndtri(0.975))

#: ``untested``: one of the logs does not determine the parameter.
Outcome: TypeAlias = Literal["differs", "same", "untested"]


@dataclass(frozen=True, kw_only=True)
class CalibrationDifference:
    """One parameter of a sensor in both calibrations; `p` is adjusted for all parameters, or None."""

    sensor: Sensor
    parameter: str
    unit: str
    a: Parameter
    b: Parameter
    p: float | None
    outcome: Outcome


def compare_calibrations(
    a: CalibrationDocument, b: CalibrationDocument, *, alpha: float = 0.05
) -> tuple[CalibrationDifference, ...]:
    """Return the difference of each parameter; a parameter differs with probability `alpha` by chance.

    Raises DataError if the two have different frames or units, or no sensor in common.
    """
    if a.frame != b.frame:
        problem = f"{a.source.name} has the frame {a.frame}, {b.source.name} the frame {b.frame}"
        raise DataError(problem, fix=Fix(f"calibrate both with --frame {a.frame}"))
    found = list(_differences(a, b))
    if not found:
        raise DataError(f"{a.source.name} and {b.source.name} have no parameter in common")
    adjusted = iter(holm([one.p for one in found if one.p is not None]))
    judged = []
    for one in found:
        p = None if one.p is None else next(adjusted)
        outcome: Outcome = "untested" if p is None else "differs" if p < alpha else "same"
        judged.append(replace(one, p=p, outcome=outcome))
    return tuple(judged)


def _differences(a: CalibrationDocument, b: CalibrationDocument) -> Iterator[CalibrationDifference]:
    pairs = [
        (Sensor.ACCELEROMETER, a.accelerometer.parameters, b.accelerometer.parameters),
        (
            Sensor.GYROSCOPE,
            a.gyroscope.parameters if a.gyroscope else {},
            b.gyroscope.parameters if b.gyroscope else {},
        ),
    ]
    for sensor, first, second in pairs:
        for name, one in first.items():
            other = second.get(name)
            if other is None:
                continue
            if one.unit != other.unit:
                problem = f"{name} of the {sensor} is in {one.unit} in one and {other.unit} in the other"
                raise DataError(problem, fix=Fix("calibrate both in the same units"))
            yield CalibrationDifference(
                sensor=sensor,
                parameter=name,
                unit=one.unit,
                a=one,
                b=other,
                p=_p(one, other),
                outcome="untested",
            )


def _p(a: Parameter, b: Parameter) -> float | None:
    """Return the two-sided p-value of a difference; None if one of the values is unknown."""
    if a.value is None or b.value is None or a.half_width is None or b.half_width is None:
        return None
    deviation = math.hypot(a.half_width, b.half_width) / _Z
    if not deviation > 0:
        return 1.0 if a.value == b.value else 0.0
    return 2 * float(ndtr(-abs(a.value - b.value) / deviation))

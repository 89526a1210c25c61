"""check: a calibration against limits -> verdicts on the size of each parameter."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

from imucal._version import __version__
from imucal.calibration.document import CalibrationDocument, SensorEntry
from imucal.checking.limits import CALIBRATION_UNITS, Limit, Limits
from imucal.checking.verdict import CheckResult, Row, are_of_noise, finding_rows, judge
from imucal.errors import Fix, LimitsError
from imucal.grading import BY_LEVEL, GRADE_TEXTS, GRADES, Grade, NoiseVerdict
from imucal.recording import Sensor
from imucal.report.numbers import Quantity

__all__ = ["check_calibration"]


def check_calibration(found: CalibrationDocument, limits: Limits) -> CheckResult:
    """Judge a calibration.json: a row for each limit on a parameter's size, and for each forbidden finding.

    Raises LimitsError if all limits are for noise, or one does not fit raw counts.
    """
    source = found.source.path
    if are_of_noise(limits) and not limits.calibration:
        advice = (
            'write limits such as [calibration.accelerometer] scale = { max = 2, unit = "%" }, '
            "or check a noise report"
        )
        problem = "this is a calibration, and the limits are for noise"
        raise LimitsError(problem, place=source, fix=Fix(advice))
    findings = found.findings
    codes = ", ".join(dict.fromkeys(finding.code for finding in findings)) or "no findings"
    grade: Grade = max((BY_LEVEL[finding.level] for finding in findings), key=GRADES.index, default="good")
    printed = GRADE_TEXTS[found.verdict]
    rows = [
        *chain.from_iterable(_calibrated(found, limit) for limit in limits.calibration),
        *finding_rows(findings, limits.findings),
    ]
    return CheckResult(
        source=source,
        level=0.95,
        rows=tuple(rows),
        undecided_fails=limits.undecided == "fail",
        version=__version__,
        noise=NoiseVerdict(grade=grade, sentence=f"{printed} ({codes})", axes=()),
    )


def _calibrated(found: CalibrationDocument, limit: Limit) -> Iterator[Row]:
    sensor = Sensor(limit.where.rpartition(".")[2])
    where, entry = sensor.short, _entry(found, sensor)
    if entry is None:
        yield Row(where, limit.quantity, "fail", f"the calibration has no {sensor}")
        return
    for name, size in _sizes(found, entry, sensor, limit.quantity):
        row = judge(
            where,
            f"|{name}|" if name != "residual" else name,
            size and size.scaled(1 / limit.factor, limit.unit),
            side=limit.side,
            limit=limit.value,
            unit=limit.unit,
        )
        if size is None:
            text = f"the log does not determine {name}; add the rests and turns that the findings name"
            row = replace(row, found=text)
        yield row


def _entry(found: CalibrationDocument, sensor: Sensor) -> SensorEntry | None:
    return found.accelerometer if sensor is Sensor.ACCELEROMETER else found.gyroscope


def _sizes(
    found: CalibrationDocument, entry: SensorEntry, sensor: Sensor, quantity: str
) -> Iterator[tuple[str, Quantity | None]]:
    """Yield the size of each parameter of a kind, or the rms residual; None if it is unknown."""
    if quantity == "residual":
        yield quantity, _residual(found, sensor)
        return
    units = CALIBRATION_UNITS[sensor][quantity]
    for name, parameter in entry.parameters.items():
        if not name.startswith(quantity):
            continue
        unit = parameter.unit
        if unit not in units:
            msg = (
                f"{found.source.path}: {name} of the {sensor} is in raw counts; calibrate with "
                "the scale of the sensor, or remove the limit"
            )
            raise LimitsError(msg)
        if parameter.value is None or parameter.low is None or parameter.high is None:
            yield name, None
            continue
        factor = units[unit]
        value, low, high = parameter.value * factor, parameter.low * factor, parameter.high * factor
        least = 0.0 if low <= 0 <= high else min(abs(low), abs(high))
        yield name, Quantity(value=abs(value), low=least, high=max(abs(low), abs(high)))


def _residual(found: CalibrationDocument, sensor: Sensor) -> Quantity | None:
    """Return the rms error of |f| in the rests, or of the direction after the turns."""
    if sensor is Sensor.ACCELEROMETER:
        sizes = [rest.residual for rest in found.rests if rest.used]
    else:
        errors_deg = [
            turn.residual_deg for turn in found.turns if turn.used and turn.residual_deg is not None
        ]
        sizes = [math.radians(math.hypot(*error)) for error in errors_deg]
    return Quantity.exactly(math.hypot(*sizes) / math.sqrt(len(sizes))) if sizes else None

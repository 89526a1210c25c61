"""Kalibr's results of a camera-IMU calibration -> verdicts on its residuals and on the noise it was given.

Kalibr prints the mean, median and standard deviation of the normalised residuals of each camera and each IMU.
It prints no expectation: 1.596 for three axes and 1.253 for two pixels. With a report of the same sensor at
rest, each number of imu.yaml has a factor too.

Source: Kalibr, ``kalibr_imu_camera_calibration/IccUtil.py`` and ``kalibr_common/ConfigReader.py`` (layout),
``IccSensors.py`` (the discrete noise is the density times the root of the rate).
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from imucal.checking.config_files import Setting, noise_rows, rate_rows, read_settings
from imucal.checking.limits import text_of
from imucal.checking.residuals import NO_DATA, WITHIN, Expected, result_of, verdict_of
from imucal.checking.verdict import CheckResult, Row, Verdict
from imucal.errors import Fix, LimitsError
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report.exports import TARGETS
from imucal.report.exports.config_numbers import DEFAULT_OPTIONS
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report

__all__ = ["are_results", "check_numbers", "check_residuals"]

_EXPECTED = "the results of Kalibr's camera-IMU calibration"
_TITLE = "Normalized Residuals"
_END = "Residuals"
#: Confidence level of a report's intervals; residuals have none.
_LEVEL = 0.95
#: First bytes in which the title must be.
_HEAD = 4096
#: Largest ratio of the mean to the median of ordinary residuals; 1.04 is expected, and calibrations that
#: people published have 1.1 to 1.3, because the noise is larger in fast motion.
_ORDINARY = 1.5
#: Name of a residual in the results -> its degrees of freedom, and its name in a row.
_KINDS = {
    "Gyroscope": (3, Sensor.GYROSCOPE.short),
    "Accelerometer": (3, Sensor.ACCELEROMETER.short),
    "Reprojection": (2, "corners"),
}
_RESIDUAL = re.compile(
    r"(?P<kind>Reprojection|Gyroscope|Accelerometer) error \((?P<of>\w+)\):\s*"
    r"(?:mean:?\s*(?P<mean>[^,\s]+),\s*median:?\s*(?P<median>[^,\s]+),\s*std:?\s*(?P<std>\S+)|(?P<none>\S.*))"
)
_IMU = re.compile(r"IMU(\d+):")
_DETAIL = re.compile(r"(Accelerometer|Gyroscope|Update rate|Noise density|Random walk):\s*(\S*)")
#: Words of Kalibr's printed configuration -> the end of the key in imu.yaml.
_KEYS = {"Noise density": "noise_density", "Random walk": "random_walk"}


@dataclass(frozen=True)
class _Residual:
    """One line of the results: of a camera or an IMU, from line 1; NaN without residuals."""

    kind: str
    of: str
    mean: float
    median: float
    none: str

    @property
    def dimension(self) -> int:
        return _KINDS[self.kind][0]

    @property
    def where(self) -> str:
        return f"{self.of} {_KINDS[self.kind][1]}"

    @property
    def factor(self) -> float:
        """The given noise is this many times too small; from the median, which outliers do not affect."""
        return self.median / Expected.of(self.dimension).median

    @property
    def is_empty(self) -> bool:
        return not NO_DATA < self.factor < math.inf


def are_results(path: Path) -> bool:
    """Return whether a file contains the results of Kalibr's camera-IMU calibration."""
    try:
        with path.open("rb") as file:
            return f"\n{_TITLE}".encode() in b"\n" + file.read(_HEAD)
    except OSError:
        return False


def check_residuals(path: Path) -> CheckResult:
    """Judge the normalised residuals of each camera and each IMU.

    Raises LimitsError if the file can't be read or has no residuals.
    """
    rows = tuple(map(_residual_row, _residuals(path)))
    return result_of(path, rows, "residuals", _LEVEL)


def check_numbers(path: Path, report: Report, imu: int | None = None) -> tuple[Row, ...]:
    """Return a row for each number of imu.yaml that Kalibr used, and for the noise that Kalibr saw.

    `imu` is the number of the report's IMU, needed if Kalibr calibrated several. Raises LimitsError if the
    file has no such IMU, and DataError if the report lacks an axis.
    """
    settings = _settings(path)
    if imu is None and len(settings) > 1:
        names = " or ".join(map(str, settings))
        problem = f"the results are of {len(settings)} IMUs, and the report is of one"
        raise LimitsError(problem, place=path, fix=Fix(f"give --imu {names}"))
    chosen = next(iter(settings)) if imu is None else imu
    if chosen not in settings:
        names = ", ".join(f"IMU{number}" for number in settings)
        raise LimitsError(f"found no IMU{chosen}; found {names}", place=path)
    target, given = TARGETS["kalibr"], settings[chosen]
    own = read_settings(target.render(report, DEFAULT_OPTIONS))
    numbers = target.numbers(report, DEFAULT_OPTIONS)
    return (
        *(replace(row, in_words=True) for row in noise_rows(given, target.keys, own, numbers)),
        *rate_rows(given, own, numbers.stream_hz),
        *_seen(_residuals(path), given, report, f"imu{chosen}"),
    )


def _residuals(path: Path) -> tuple[_Residual, ...]:
    found = list[_Residual]()
    lines = [line.strip() for line in text_of(path, _EXPECTED).splitlines()]
    # What Kalibr printed on the terminal also contains the residuals before the optimization.
    start = len(lines) - lines[::-1].index(_TITLE) if _TITLE in lines else len(lines)
    for line in lines[start:]:
        if line == _END:
            break
        match = _RESIDUAL.match(line)
        if match is not None:
            mean, median = (_number(match[name] or "") for name in ("mean", "median"))
            found.append(_Residual(match["kind"], match["of"], mean, median, match["none"] or ""))
    if not found:
        problem = "found no normalised residuals; expected results-imucam.txt of Kalibr"
        raise LimitsError(problem, place=path)
    return tuple(found)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _residual_row(residual: _Residual) -> Row:
    expected = Expected.of(residual.dimension)
    subject = f"{residual.kind.lower()} residual"
    if residual.none:
        found = f"no residuals ({residual.none}): the target was not found in the images"
        return Row(residual.where, subject, "fail", found)
    shown = f"mean {residual.mean:.4g}, expected {expected.mean:.4g}"
    if residual.is_empty:
        return Row(residual.where, subject, "fail", f"{shown}: no data or a broken input, not a good result")
    verdict, words = _judged(residual)
    if residual.mean > _ORDINARY * residual.median:
        verdict = "fail" if verdict == "fail" else "undecided"
        words += (
            f"; the mean is {residual.mean / residual.median:.3g} times the median, expected "
            f"{expected.mean / expected.median:.3g}: outliers, such as shocks or late images"
        )
    return Row(
        residual.where,
        subject,
        verdict,
        f"{shown}; {words}",
        measured=Quantity.exactly(residual.mean),
        in_words=True,
    )


def _judged(residual: _Residual) -> tuple[Verdict, str]:
    verdict, words = verdict_of(residual.factor)
    if residual.kind == "Reprojection":
        return _judged_corners(verdict, residual.factor)
    if residual.factor > 1 and verdict != "pass":
        return verdict, f"{words}, or the spline cannot follow the motion (vibration, shocks)"
    if verdict != "pass":
        return verdict, f"{words}, or the spline follows the noise"
    return verdict, words


def _judged_corners(verdict: Verdict, factor: float) -> tuple[Verdict, str]:
    if verdict == "pass":
        return verdict, "the noise in pixels is right within a factor of 2"
    if factor < 1:
        return "pass", "the corners are better than the assumed noise in pixels"
    words = (
        f"the corners are {factor:.3g} times worse than the assumed noise in pixels: check the camera's "
        "intrinsics, the size of the target and the delay"
    )
    return verdict, words


def _settings(path: Path) -> dict[int, list[Setting]]:
    """Return the numbers of imu.yaml of each IMU, as lines of that file."""
    found = dict[int, list[Setting]]()
    own: list[Setting] | None = None
    sensor = ""
    text = text_of(path, _EXPECTED)
    for number, line in enumerate(map(str.strip, text.splitlines()), 1):
        imu = _IMU.fullmatch(line)
        if imu is not None:
            own = found.setdefault(int(imu[1]), [])
            continue
        detail = _DETAIL.match(line)
        if own is None or detail is None:
            continue
        name, value = detail.groups()
        if name in ("Accelerometer", "Gyroscope"):
            sensor = name.lower()
        elif name == "Update rate":
            own.append(_setting(path, number, "update_rate", value))
        elif sensor:
            own.append(_setting(path, number, f"{sensor}_{_KEYS[name]}", value))
    if not found:
        raise LimitsError("found no IMU configuration; expected all of Kalibr's results", place=path)
    return found


def _setting(path: Path, line: int, key: str, value: str) -> Setting:
    return Setting(path.name, line, key, (value,), f"{key}: {value}")


def _seen(
    residuals: Sequence[_Residual], settings: Sequence[Setting], report: Report, imu: str
) -> Iterator[Row]:
    """Yield the white noise that Kalibr saw, and its ratio to the noise of the report."""
    for sensor, axes in report.by_sensor.items():
        where = (str(sensor).capitalize(), imu)
        seen = next((each for each in residuals if (each.kind, each.of) == where), None)
        density = _density(settings, sensor)
        at_rest = _largest_n(axes)
        if seen is None or seen.is_empty or not density or not at_rest:
            continue
        size = density * seen.factor
        unit = TERMS["N"].unit(sensor)
        ratio = size / at_rest
        found = f"Kalibr saw {size:.4g} {unit}, {ratio:.3g} times N of the report"
        if ratio > WITHIN:
            found += ": vibration, shocks, an error of scale, or a spline that is too stiff add to it"
        yield Row(
            f"{imu} {sensor.short}",
            "noise in Kalibr",
            "pass",
            found,
            measured=Quantity.exactly(size),
            unit=unit,
            in_words=True,
        )


def _density(settings: Sequence[Setting], sensor: Sensor) -> float:
    """Return the white noise that Kalibr was given; 0 if it is not a number."""
    names = f"{sensor}_noise_density"
    return next((each.numbers[0] for each in settings if each.name == names and each.numbers), 0.0)


def _largest_n(axes: Sequence[AxisReport]) -> float:
    """Return the largest N of some axes; 0 if no axis shows it."""
    estimates = (estimate for axis in axes for estimate in axis.fit.estimates)
    return max((estimate.value or 0.0 for estimate in estimates if estimate.symbol == "N"), default=0.0)

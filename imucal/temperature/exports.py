"""The curves of a temperature ramp as parameters of flight stacks, and as code.

Formulas were read in the programs' sources: PX4 (TemperatureCompensation.cpp: the temperature is limited to
TMIN … TMAX, offset = X0 + X1 d + X2 d² + X3 d³ with d = T - TREF, corrected = raw - offset), ArduPilot
(AP_InertialSensor_tempcal.cpp: the same without constant, with d = T - 35 °C and coefficients times 10⁶).
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from imucal._version import __version__
from imucal.arrays import FloatArray
from imucal.atomic import write_configs
from imucal.errors import ArgumentError, DataError, Fix
from imucal.printable import one_line
from imucal.recording import Sensor
from imucal.report.exports.target import comment, name_key, template
from imucal.temperature.curve import Curve
from imucal.temperature.result import AxisThermal, Thermal

__all__ = ["THERMAL_TARGETS", "ThermalTarget", "export_thermal", "find_thermal_target", "render_thermal"]

#: Reference temperature of ArduPilot, in degrees Celsius.
_ARDUPILOT_C = 35.0
#: ArduPilot's parameters are multiplied by this, so that they are easy to edit.
_ARDUPILOT_SCALE = 1e6
#: Order of the polynomials of flight stacks.
_CUBIC = 3
#: Sensor -> its letter in PX4's parameters.
_PX4 = {Sensor.GYROSCOPE: "G", Sensor.ACCELEROMETER: "A"}
#: Sensor -> its name in ArduPilot's parameters.
_ARDUPILOT = {Sensor.GYROSCOPE: "GYR", Sensor.ACCELEROMETER: "ACC"}


@dataclass(frozen=True, kw_only=True)
class ThermalTarget:
    """A program or language: its file, the sign of a comment, and the function that returns the text below.

    `cubic` is whether it knows only a cubic of the present temperature.
    """

    name: str
    title: str
    file_name: str
    sign: str
    body: Callable[[Thermal], str]
    cubic: bool = False


def find_thermal_target(name: str) -> ThermalTarget:
    """Return a program by its name, ignoring case and hyphens, or raise an ArgumentError."""
    for target in THERMAL_TARGETS.values():
        if name_key(target.name) == name_key(name):
            return target
    fix = Fix(f"choose one of {', '.join(THERMAL_TARGETS)}", "target")
    raise ArgumentError(f"no format {name!r} for a temperature ramp", fix=fix)


def render_thermal(found: Thermal, name: str) -> str:
    """Return the text of a file, a key of `THERMAL_TARGETS`.

    Raises DataError if a sensor lacks an axis, ArgumentError for an unknown name.
    """
    target = find_thermal_target(name)
    return f"{comment(_comment(target, found), target.sign)}\n{target.body(found).strip()}\n"


def export_thermal(found: Thermal, name: str, path: Path) -> Path:
    """Write the text of `render_thermal` to a file, or into a folder."""
    return write_configs({find_thermal_target(name).file_name: render_thermal(found, name)}, path)[0]


def _comment(target: ThermalTarget, found: Thermal) -> Iterator[str]:
    yield f"{target.title}, written by imucal {__version__}"
    yield f"bias over temperature from {one_line(found.source.name)}"
    yield f"valid from {found.low_c:.1f} to {found.high_c:.1f} degrees Celsius; use the ends outside"
    yield "gyroscope in rad/s; accelerometer in m/s^2, less the value at the reference temperature (gravity)"
    for axis in found.axes:
        error = axis.cubic_held_out if target.cubic else axis.held_out
        if error is not None:
            yield f"{axis.name}: rms error {error:.3g} {axis.sensor.unit} in parts that the fit has not seen"
    if target.cubic and any(axis.curve.kind != "present" for axis in found.axes):
        yield "this program knows no lag of the temperature: c, python, matlab and yaml have the better curve"
    codes = dict.fromkeys(each.code for each in found.findings if each.level != "info")
    if codes:
        yield f"read the page before you use these numbers; it warns of: {', '.join(codes)}"


def correction_of(axis: AxisThermal, *, cubic: bool = False) -> Curve:
    """Return the curve to subtract: without constant for an accelerometer, whose mean is gravity."""
    curve = axis.cubic if cubic else axis.curve
    return curve if axis.sensor is Sensor.GYROSCOPE else curve.without_constant()


def _triads(found: Thermal) -> dict[Sensor, tuple[AxisThermal, ...]]:
    triads = {sensor: triad for sensor in Sensor if (triad := found.triad(sensor)) is not None}
    if not triads:
        problem = "no sensor with the axes x, y and z"
        raise DataError(problem, place=found.source.path)
    return triads


def _padded(curve: Curve) -> FloatArray:
    return np.pad(curve.coefficients, (0, _CUBIC - curve.order))


def px4_parameters(found: Thermal) -> dict[str, float]:
    """Return the parameters of PX4 by name."""
    parameters: dict[str, float] = {}
    for sensor, triad in _triads(found).items():
        start = f"TC_{_PX4[sensor]}"
        parameters[f"{start}_ENABLE"] = 1
        curves = [correction_of(axis, cubic=True) for axis in triad]
        for power in range(_CUBIC, -1, -1):
            for number, curve in enumerate(curves):
                parameters[f"{start}0_X{power}_{number}"] = float(_padded(curve)[power])
        parameters[f"{start}0_TREF"] = curves[0].reference_c
        parameters[f"{start}0_TMIN"] = found.low_c
        parameters[f"{start}0_TMAX"] = found.high_c
    return parameters


def ardupilot_parameters(found: Thermal) -> dict[str, float]:
    """Return the parameters of ArduPilot by name."""
    parameters: dict[str, float] = {
        "INS_TCAL1_ENABLE": 1,
        "INS_TCAL1_TMIN": found.low_c,
        "INS_TCAL1_TMAX": found.high_c,
    }
    for sensor, triad in _triads(found).items():
        for axis in triad:
            coefficients = _padded(moved(axis.cubic, _ARDUPILOT_C)) * _ARDUPILOT_SCALE
            for power in range(1, _CUBIC + 1):
                name = f"INS_TCAL1_{_ARDUPILOT[sensor]}{power}_{axis.axis.upper()}"
                parameters[name] = float(coefficients[power])
    return parameters


def moved(curve: Curve, reference_c: float) -> Curve:
    """Return the same polynomial about another reference temperature."""
    polynomial = np.polynomial.Polynomial(curve.coefficients)
    offset = np.polynomial.Polynomial([reference_c - curve.reference_c, 1.0])
    coefficients = np.atleast_1d(np.asarray(polynomial(offset).coef, np.float64))
    padded = np.pad(coefficients, (0, curve.order + 1 - coefficients.size))
    return curve.about(reference_c, padded)


def _px4(found: Thermal) -> str:
    # The type of a parameter: 6 is an integer, 9 a float.
    rows = [
        f"1\t1\t{name}\t{value:.9g}\t{6 if name.endswith('ENABLE') else 9}"
        for name, value in px4_parameters(found).items()
    ]
    sensors = [_PX4[sensor] for sensor in _triads(found)]
    needed = [f"# set TC_{letter}0_ID to the ID of your sensor, CAL_*0_ID" for letter in sensors]
    return "\n".join([*needed, *rows])


def _ardupilot(found: Thermal) -> str:
    return "\n".join(f"{name} {value:.9g}" for name, value in ardupilot_parameters(found).items())


def _code(name: str) -> Callable[[Thermal], str]:
    """Return the function that fills the template of a language."""

    def body(found: Thermal) -> str:
        axes = [(axis, correction_of(axis)) for triad in _triads(found).values() for axis in triad]
        size = max(curve.coefficients.size for _, curve in axes)
        text = files("imucal.temperature").joinpath("templates", f"thermal_{name}.txt").read_text("utf-8")
        return template(text).render(axes=axes, size=size, number=_number, list=_list)

    return body


def _number(value: float) -> str:
    """Return a number with a decimal point and nine digits, which are enough for a float."""
    if not math.isfinite(value):
        raise DataError(f"only finite numbers can be written, got {value}")
    text = f"{value:.9g}"
    return text if "." in text or "e" in text else f"{text}.0"


def _list(values: FloatArray, size: int, between: str = ", ", end: str = "") -> str:
    padded = np.pad(values, (0, size - values.size))
    return between.join(f"{_number(value)}{end}" for value in padded.tolist())


#: Name -> program or language.
THERMAL_TARGETS: dict[str, ThermalTarget] = {
    target.name: target
    for target in (
        ThermalTarget(
            name="px4",
            title="PX4 thermal compensation",
            file_name="px4_thermal.params",
            sign="#",
            body=_px4,
            cubic=True,
        ),
        ThermalTarget(
            name="ardupilot",
            title="ArduPilot IMU temperature calibration",
            file_name="ardupilot_thermal.parm",
            sign="#",
            body=_ardupilot,
            cubic=True,
        ),
        ThermalTarget(
            name="c",
            title="C header",
            file_name="imu_thermal.h",
            sign="//",
            body=_code("c"),
        ),
        ThermalTarget(
            name="python",
            title="Python module",
            file_name="imu_thermal.py",
            sign="#",
            body=_code("python"),
        ),
        ThermalTarget(
            name="matlab",
            title="MATLAB function",
            file_name="imu_thermal.m",
            sign="%",
            body=_code("matlab"),
        ),
        ThermalTarget(
            name="yaml",
            title="YAML",
            file_name="imu_thermal.yaml",
            sign="#",
            body=_code("yaml"),
        ),
    )
}

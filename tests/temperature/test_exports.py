"""Tests of exported curves, evaluated as their consumers do: in single precision."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError
from imucal.recording import Sensor, Source
from imucal.temperature import Thermal
from imucal.temperature.curve import Curve
from imucal.temperature.exports import (
    THERMAL_TARGETS,
    ardupilot_parameters,
    correction_of,
    export_thermal,
    find_thermal_target,
    px4_parameters,
    render_thermal,
)
from imucal.temperature.result import AxisThermal, Branch
from tests.raising import raises

F = np.float32
#: Temperatures in and outside the range.
TEMPERATURES = np.linspace(-30.0, 85.0, 47)
#: Time between two calls, in s.
STEP_S = 2.0
#: The largest difference, as a share of the largest bias.
EXACT = 1e-6


def curve(rng: np.random.Generator, kind: str, order: int, size: float) -> Curve:
    powers = 35.0 ** -np.arange(order + 1)
    return Curve(
        kind=kind,  # type: ignore[arg-type]
        reference_c=24.3,
        low_c=-17.0,
        high_c=66.0,
        coefficients=size * powers * rng.standard_normal(order + 1),
        covariance=np.zeros((order, order)),
        lag_s=0.0 if kind == "present" else 45.0,
        gradient=size / 60 if kind == "gradient" else 0.0,
    )


@pytest.fixture(scope="module")
def found() -> Thermal:
    rng = np.random.default_rng(21)
    kinds = ("present", "lagged", "gradient")
    axes = [
        AxisThermal(
            sensor=sensor,
            axis=axis,  # type: ignore[arg-type]
            curve=curve(rng, kinds[number], 3 + number, 0.01 if sensor is Sensor.GYROSCOPE else 0.3),
            cubic=curve(rng, "present", 3 - number, 0.01 if sensor is Sensor.GYROSCOPE else 0.3),
            noise=1e-3,
            before=1.0,
            left=0.1,
            held_out=0.2,
            cubic_held_out=0.4,
            hysteresis=None,
            hysteresis_left=None,
        )
        for sensor in Sensor
        for number, axis in enumerate("xyz")
    ]
    return Thermal(
        source=Source(path="ramp.csv", format="csv"),
        low_c=-17.0,
        high_c=66.0,
        fastest_k_per_s=0.02,
        branches=(Branch(start_s=0.0, end_s=1.0, from_c=-17.0, to_c=66.0),),
        axes=tuple(axes),
        findings=(),
    )


def lagging(temperature: FloatArray, lag_s: float) -> FloatArray:
    """Return the temperature behind a lag, by the step of its differential equation."""
    values = [temperature[0]]
    for one in temperature[1:]:
        share = 1 - np.exp(-STEP_S / lag_s) if lag_s else 1.0
        values.append(values[-1] + share * (one - values[-1]))
    return np.array(values)


def ours(found: Thermal) -> Iterator[tuple[str, FloatArray]]:
    for axis in found.axes:
        own = correction_of(axis)
        yield axis.name, own.bias(TEMPERATURES, lagging(TEMPERATURES, own.lag_s))


def close(values: Any, expected: FloatArray) -> bool:  # noqa: ANN401 - arrays of any precision
    return bool(np.abs(np.asarray(values, float) - expected).max() <= EXACT * np.abs(expected).max())


def test_px4_computes_the_cubic(found: Thermal) -> None:
    """TemperatureCompensation: limited to TMIN … TMAX, then a polynomial of T - TREF in floats."""
    text = render_thermal(found, "px4")
    rows = re.findall(r"^1\t1\t(\S+)\t(\S+)\t([69])$", text, re.MULTILINE)
    read = {name: F(value) for name, value, _ in rows}
    assert set(read) == set(px4_parameters(found))
    for sensor, letter in ((Sensor.GYROSCOPE, "G"), (Sensor.ACCELEROMETER, "A")):
        start = f"TC_{letter}0"
        assert read[f"TC_{letter}_ENABLE"] == 1
        limited = np.clip(F(TEMPERATURES), read[f"{start}_TMIN"], read[f"{start}_TMAX"])
        d = limited - read[f"{start}_TREF"]
        for number, axis in enumerate(found.triad(sensor) or ()):
            x = [read[f"{start}_X{power}_{number}"] for power in range(4)]
            offset = x[0] + x[1] * d + x[2] * d * d + x[3] * d * d * d
            assert offset.dtype == F
            assert close(offset, correction_of(axis, cubic=True).static(TEMPERATURES))


def test_ardupilot_computes_the_cubic(found: Thermal) -> None:
    """AP_InertialSensor_tempcal: about 35 °C, without constant, coefficients times a million."""
    text = render_thermal(found, "ardupilot")
    read = {name: F(value) for name, value in re.findall(r"^(INS_\S+) (\S+)$", text, re.MULTILINE)}
    assert set(read) == set(ardupilot_parameters(found))
    d = np.clip(F(TEMPERATURES), read["INS_TCAL1_TMIN"], read["INS_TCAL1_TMAX"]) - F(35)
    for axis in found.axes:
        name = {"gyro": "GYR", "accel": "ACC"}[axis.sensor.short]
        c = [read[f"INS_TCAL1_{name}{power}_{axis.axis.upper()}"] for power in (1, 2, 3)]
        offset = (c[0] + (c[1] + c[2] * d) * d) * d * F(1e-6)
        expected = axis.cubic.static(TEMPERATURES) - axis.cubic.static(np.array([35.0]))
        assert close(offset, expected)


def test_python_computes_the_curve(found: Thermal) -> None:
    """The module follows the temperature call by call."""
    module: dict[str, Any] = {}
    exec(render_thermal(found, "python"), module)  # noqa: S102 - our own text
    state = module["ThermalBias"]()
    rows = [state.update(float(one), STEP_S) for one in TEMPERATURES]
    for name, expected in ours(found):
        assert close([row[name] for row in rows], expected)


def test_c_computes_the_curve(found: Thermal, tmp_path: Path) -> None:
    """The header compiles without a warning and computes in floats."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler")
    export_thermal(found, "c", tmp_path / "imu_thermal.h")
    program = """
#include <stdio.h>
#include "imu_thermal.h"
int main(void) {
    imu_thermal_state state = {0};
    float temperature, bias[IMU_THERMAL_AXES];
    while (scanf("%f", &temperature) == 1) {
        imu_thermal_bias(&state, temperature, 2.0f, bias);
        for (int k = 0; k < IMU_THERMAL_AXES; k++) printf("%.9g ", (double)bias[k]);
        printf("\\n");
    }
    return 0;
}
"""
    (tmp_path / "main.c").write_text(program, encoding="utf-8")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "main.c", "-o", "main", "-lm"]
    subprocess.run([compiler, *flags], cwd=tmp_path, check=True)  # noqa: S603 - our own program
    done = subprocess.run(  # noqa: S603 - as above
        [tmp_path / "main"],
        input="\n".join(map(repr, TEMPERATURES.tolist())),
        capture_output=True,
        text=True,
        check=True,
    )
    rows = np.array([line.split() for line in done.stdout.splitlines()], float)
    for column, (_, expected) in zip(rows.T, ours(found), strict=True):
        assert close(column, expected)


def test_yaml_and_matlab_have_the_numbers(found: Thermal) -> None:
    """YAML is read by a parser; the arrays of MATLAB by their rows."""
    read = yaml.safe_load(render_thermal(found, "yaml"))["imu_thermal"]
    text = render_thermal(found, "matlab")
    rows = re.search(r"^c = \[(.*); \];$", text, re.MULTILINE)
    assert rows is not None
    matrix = np.array([row.split() for row in rows.group(1).split(";")], float)
    for row, axis in zip(matrix, found.axes, strict=True):
        own = correction_of(axis)
        entry = read[axis.name]
        assert entry["coefficients"] == pytest.approx(own.coefficients.tolist(), rel=1e-8)
        assert row[: own.order + 1] == pytest.approx(own.coefficients, rel=1e-8)
        assert not row[own.order + 1 :].any()
        assert (entry["follows_lag"], entry["lag_s"]) == (own.kind == "lagged", own.lag_s)
    assert re.search(r"^lag = \[0\.0; 45\.0; 45\.0; ", text, re.MULTILINE)
    assert re.search(r"^follows = logical\(\[0; 1; 0; ", text, re.MULTILINE)


@pytest.mark.parametrize("name", THERMAL_TARGETS)
def test_every_file_says_what_it_is(found: Thermal, name: str, tmp_path: Path) -> None:
    """The comment has the source, the range and the error; a file of ours is replaced."""
    target = find_thermal_target(name.upper())
    for _ in range(2):
        path = export_thermal(found, name, tmp_path)
    assert path.name == target.file_name
    text = path.read_text(encoding="utf-8")
    assert "bias over temperature from ramp.csv" in text
    assert "valid from -17.0 to 66.0 degrees Celsius" in text
    assert f"gyro_x: rms error {'0.4' if target.cubic else '0.2'} rad/s" in text
    assert ("knows no lag" in text) == target.cubic


def test_what_can_not_be_exported(found: Thermal) -> None:
    """An unknown program; a sensor without z."""
    with raises(ArgumentError, "no format 'betaflight'"):
        render_thermal(found, "betaflight")
    alone = replace(found, axes=found.axes[:2])
    with raises(DataError, "no sensor with the axes x, y and z"):
        render_thermal(alone, "px4")


def test_gravity_is_not_subtracted() -> None:
    """The constant of an accelerometer is mostly gravity."""
    rng = np.random.default_rng(5)
    axis = AxisThermal(
        sensor=Sensor.ACCELEROMETER, axis="z", curve=curve(rng, "present", 2, 9.8),
        cubic=curve(rng, "present", 2, 9.8), noise=0.0, before=0.0, left=0.0, held_out=None,
        cubic_held_out=None, hysteresis=None, hysteresis_left=None,
    )  # fmt: skip
    assert correction_of(axis).static(np.array([24.3])).tolist() == [0.0]

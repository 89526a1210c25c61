"""Units and times that a log states in unusual ways: read, or asked for with the header quoted."""

from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ChoiceError
from imucal.readers import read
from imucal.recording import Recording, Sensor
from imucal.screening import screen_values
from imucal.units import G0, parse_sample_unit, time_unit_name, time_unit_ns
from tests.raising import raises

N = 1200
RATE = 100.0
TIME = np.arange(N) / RATE
#: White noise of a MEMS sensor at rest, in SI, shape (n, 3).
GYRO = 1.5e-3 * np.random.default_rng(55001).standard_normal((N, 3)) + (2e-3, -3e-3, 1e-3)
ACCEL = 2e-2 * np.random.default_rng(55002).standard_normal((N, 3)) + (0.3, -0.2, 9.79)
SI_NAMES = "gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"


def table(path: Path, header: str, *columns: FloatArray | IntArray, digits: int = 12) -> Path:
    """Write columns, shape (n,) or (n, 3), below a header."""
    rows = np.column_stack(columns)
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt=f"%.{digits}g")
    return path


def is_truth(recording: Recording, rate_hz: float = RATE) -> None:
    """Compare rate and samples with the ones written."""
    assert recording.series[0].rate_hz == pytest.approx(rate_hz, rel=1e-6)
    for sensor, truth in ((Sensor.GYROSCOPE, GYRO), (Sensor.ACCELEROMETER, ACCEL)):
        series = [one.samples for one in recording.series if one.sensor is sensor]
        npt.assert_allclose(np.column_stack(series), truth, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize(
    ("header", "per_second"),
    [
        ("Time (min)", 1 / 60),
        ("elapsed_min", 1 / 60),
        ("t_min", 1 / 60),
        ("Time [h]", 1 / 3600),
        ("time_hours", 1 / 3600),
        ("time [d]", 1 / 86400),
        ("time_100us", 1e4),
        ("t_10us", 1e5),
        ("time (10 ms)", 100),
        ("timestamp [100 ns]", 1e7),
    ],
)
def test_a_unit_in_the_name_of_a_time_is_understood(tmp_path: Path, header: str, per_second: float) -> None:
    is_truth(read(table(tmp_path / "log.csv", f"{header},{SI_NAMES}", TIME * per_second, GYRO, ACCEL)))


@pytest.mark.parametrize("header", ["time (10 ticks)", "t [1/32768 s]", "time (beats/s)"])
def test_an_unknown_unit_of_a_time_is_quoted_and_asked_for(tmp_path: Path, header: str) -> None:
    """The counts alone would fit milliseconds."""
    path = table(tmp_path / "log.csv", f"{header},{SI_NAMES}", np.arange(N), GYRO, ACCEL)
    quoted = header[header.index("(") + 1 : -1] if "(" in header else header[header.index("[") + 1 : -1]
    with raises(ChoiceError, "is not a known unit", place="log.csv", argument="time_unit") as error:
        read(path)
    assert repr(quoted) in str(error.value)
    is_truth(read(path, time_unit="10ms"))
    is_truth(read(path, rate_hz=RATE))


@pytest.mark.parametrize(
    ("text", "ns", "name"),
    [
        ("100ns", 100, "100 ns"),
        ("10 us", 10_000, "10 us"),
        ("min", 60 * 10**9, "min"),
        ("hours", 3600 * 10**9, "h"),
        ("d", 86400 * 10**9, "d"),
        ("1000 us", 10**6, "ms"),
    ],
)
def test_a_time_unit_may_have_a_number(text: str, ns: int, name: str) -> None:
    assert time_unit_ns(text) == ns
    assert time_unit_name(ns) == name


@pytest.mark.parametrize("text", ["0.5 ns", "ticks", "10 ticks", "1e400 s", "", "10"])
def test_other_texts_are_not_time_units(text: str) -> None:
    assert time_unit_ns(text) is None


MOVELLA = "SampleTimeFine,Euler_X,Euler_Y,Euler_Z,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"


@pytest.mark.parametrize(("per_second", "counter"), [(1e6, ""), (1e4, ""), (1e6, "PacketCounter,")])
def test_the_time_of_xsens_is_read_with_the_rate_of_an_imu(
    tmp_path: Path, per_second: float, counter: str
) -> None:
    """DOT counts microseconds, MTi 0.1 ms; other columns are the same."""
    counters = [np.arange(N)] if counter else []
    columns = [*counters, np.round(677583000 + TIME * per_second), np.ones((N, 3)), ACCEL, np.degrees(GYRO)]
    path = table(tmp_path / "log.csv", counter + MOVELLA, *columns)
    is_truth(read(path, gyro_unit="deg/s"))


def test_an_ambiguous_time_of_xsens_is_asked_for(tmp_path: Path) -> None:
    """A step of 800 is 1250 Hz in us, and 12.5 Hz in 0.1 ms."""
    path = table(tmp_path / "log.csv", MOVELLA, 800 * np.arange(N), np.ones((N, 3)), ACCEL, np.degrees(GYRO))
    with raises(ChoiceError, r"1250 Hz in steps of us or 12\.5 Hz", place="log.csv", argument="time_unit"):
        read(path, gyro_unit="deg/s")
    is_truth(read(path, gyro_unit="deg/s", time_unit="us"), 1250.0)
    is_truth(read(path, gyro_unit="deg/s", rate_hz=12.5), 12.5)


ACCEL_UNITS = {
    "Gal": 100,
    "gal": 100,
    "mGal": 1e5,
    "cm/s^2": 100,
    "cm/s²": 100,
    "mm/s^2": 1e3,
    "µm/s²": 1e6,
    "ft/s^2": 1 / 0.3048,
}
GYRO_UNITS = {
    "rpm": 30 / np.pi,
    "rev/s": 0.5 / np.pi,
    "deg/min": np.degrees(60),
    "rad/h": 3600,
    "arcsec/s": np.degrees(3600),
}


@pytest.mark.parametrize(("unit", "per_si"), ACCEL_UNITS.items())
@pytest.mark.parametrize("form", ["a{} [{}]", "a{} ({})"])
def test_units_of_accelerometers_are_known(tmp_path: Path, unit: str, per_si: float, form: str) -> None:
    names = ",".join(form.format(axis, unit) for axis in "xyz")
    header = f"time_s,gx (rad/s),gy (rad/s),gz (rad/s),{names}"
    path = table(tmp_path / "log.csv", header, TIME, GYRO, ACCEL * per_si)
    is_truth(read(path))


@pytest.mark.parametrize(("unit", "per_si"), GYRO_UNITS.items())
def test_units_of_gyroscopes_are_known(tmp_path: Path, unit: str, per_si: float) -> None:
    names = ",".join(f"g{axis} ({unit})" for axis in "xyz")
    header = f"time_s,{names},ax (m/s^2),ay (m/s^2),az (m/s^2)"
    path = table(tmp_path / "log.csv", header, TIME, GYRO * per_si, ACCEL)
    is_truth(read(path))


@pytest.mark.parametrize(
    ("sensor", "form"),
    [
        ("gyro", "g{} (furlong/s)"),
        ("gyro", "gyro_{}_rps"),
        ("accel", "a{} [cnt/g]"),
        ("accel", "a{} (kg·m/s²)"),
    ],
)
def test_an_unknown_unit_of_a_sensor_is_quoted_and_asked_for(tmp_path: Path, sensor: str, form: str) -> None:
    """The samples are in SI and would be read without a question if the header had no unit."""
    names = {"gyro": "g{} (rad/s)", "accel": "a{} (m/s^2)"} | {sensor: form}
    header = ",".join(name.format(axis) for name in names.values() for axis in "xyz")
    path = table(tmp_path / "log.csv", f"time_s,{header}", TIME, GYRO, ACCEL)
    with raises(ChoiceError, "is not a known unit", place="log.csv") as error:
        read(path)
    assert form.format("x") in str(error.value)
    is_truth(read(path, gyro_unit="rad/s", accel_unit="m/s^2"))


@pytest.mark.parametrize("label", ["raw", "body frame", "IMU", "calibrated"])
def test_a_label_in_brackets_is_not_a_unit(tmp_path: Path, label: str) -> None:
    names = ",".join(f"{letter}{axis} ({label})" for letter in "ga" for axis in "xyz")
    is_truth(read(table(tmp_path / "log.csv", f"time_s,{names}", TIME, GYRO, ACCEL)))


def test_gravity_in_gal_and_in_mg_is_asked_for(tmp_path: Path) -> None:
    """981 is gravity in cm/s², and in mg with a scale error of 1.9 %."""
    path = table(tmp_path / "log.csv", "time_s,gx,gy,gz,ax,ay,az", TIME, GYRO, ACCEL * 100)
    with raises(ChoiceError, r"Gal\), and in mg", place="log.csv", argument="accel_unit"):
        read(path, gyro_unit="rad/s")
    is_truth(read(path, gyro_unit="rad/s", accel_unit="Gal"))


@pytest.mark.parametrize(
    "header",
    [
        "t(s),dtheta_x(rad),dtheta_y(rad),dtheta_z(rad),dvel_x(m/s),dvel_y(m/s),dvel_z(m/s)",
        "t(s),dThetaX[rad],dThetaY[rad],dThetaZ[rad],dVelX[m/s],dVelY[m/s],dVelZ[m/s]",
        "t(s),delta_angle_x_rad,delta_angle_y_rad,delta_angle_z_rad,dv_x (m/s),dv_y (m/s),dv_z (m/s)",
    ],
)
def test_increments_with_a_unit_are_read(tmp_path: Path, header: str) -> None:
    """Each sample is the integral over the period since the previous one."""
    path = table(tmp_path / "log.csv", header, TIME, GYRO / RATE, ACCEL / RATE)
    is_truth(read(path))
    is_truth(read(path, gyro_unit="rad", accel_unit="m/s"))


def test_increments_without_a_unit_are_named(tmp_path: Path) -> None:
    """|a| times the rate is gravity."""
    path = table(
        tmp_path / "log.csv", "time_s,gx,gy,gz,ax,ay,az", TIME, np.degrees(GYRO) / RATE, ACCEL / RATE
    )
    with raises(ChoiceError, "in m/s per sample at 100 Hz", place="log.csv", argument="accel_unit"):
        read(path)
    is_truth(read(path, gyro_unit="deg", accel_unit="m/s"))


def test_increments_read_in_si_are_reported(tmp_path: Path) -> None:
    path = table(tmp_path / "log.csv", f"time_s,{SI_NAMES}", TIME, GYRO / RATE, ACCEL / RATE)
    found = [finding for finding in screen_values(read(path)) if finding.axis == "accel"]
    assert [(finding.level, finding.code) for finding in found] == [("warning", "unit-suspect")]
    assert "--accel-unit m/s" in found[0].advice


def test_r_is_the_rotation_rate_next_to_a_direction_of_gravity(tmp_path: Path) -> None:
    """As apps of phones name gravity and the acceleration without it."""
    gravity = np.tile(ACCEL.mean(axis=0) / np.linalg.norm(ACCEL.mean(axis=0)), (N, 1))
    gravity += 1e-5 * np.random.default_rng(55003).standard_normal((N, 3))
    header = "time_s,ax,ay,az,rx,ry,rz,mx,my,mz,gx,gy,gz"
    free = ACCEL - ACCEL.mean(axis=0)
    path = table(tmp_path / "log.csv", header, TIME, free, GYRO, np.tile((20.0, -3.0, 40.0), (N, 1)), gravity)
    recording = read(path, gyro_unit="rad/s", accel_unit="m/s^2")
    npt.assert_allclose(np.column_stack([one.samples for one in recording.series[:3]]), GYRO, rtol=1e-8)
    with raises(ChoiceError, "direction of gravity", place="log.csv", argument="columns"):
        read(path, columns="t=0,a=1:4,g=10:13", gyro_unit="deg/s", accel_unit="m/s^2")


def test_r_is_left_out_next_to_a_gyroscope(tmp_path: Path) -> None:
    """gx, gy, gz of changing length are rotation rates; rx, ry, rz may be an attitude."""
    header = "time_s,ax,ay,az,rx,ry,rz,mx,my,mz,gx,gy,gz"
    attitude = np.tile((0.1, 0.2, 0.3), (N, 1))
    path = table(tmp_path / "log.csv", header, TIME, ACCEL, attitude, attitude, GYRO)
    is_truth(read(path, gyro_unit="rad/s"))


@pytest.mark.parametrize("accel_unit", ["g", "mg", None])
def test_the_unit_of_the_accelerometer_does_not_suggest_one_of_the_gyroscope(
    tmp_path: Path, accel_unit: str | None
) -> None:
    """Core Motion and Livox have g and rad/s."""
    names = ",".join(f"a{axis} ({accel_unit})" if accel_unit else f"a{axis}" for axis in "xyz")
    scale = {"g": 1 / G0, "mg": 1e3 / G0, None: 1 / G0}[accel_unit]
    path = table(tmp_path / "log.csv", f"time_s,gx,gy,gz,{names}", TIME, GYRO, ACCEL * scale)
    with raises(ChoiceError, "in rad/s, and one in deg/s", place="log.csv", argument="gyro_unit") as error:
        read(path)
    assert "likely" not in str(error.value)


def test_a_given_unit_that_gravity_confirms_is_a_note(tmp_path: Path) -> None:
    """The header states m/s², the samples are in g."""
    path = table(tmp_path / "log.csv", f"time_s,{SI_NAMES}", TIME, GYRO, ACCEL / G0)
    levels = {finding.code: finding.level for finding in read(path, accel_unit="g").findings}
    assert levels["unit-given"] == "info"
    contradicted = read(path, accel_unit="mg")
    assert {finding.code: finding.level for finding in contradicted.findings}["unit-given"] == "warning"


@pytest.mark.parametrize("text", ["Gal", "mGal", "RPM", "°/min", "arcsec/s", "ft/s²"])
def test_spellings_of_new_units(text: str) -> None:
    assert parse_sample_unit(text) is not None

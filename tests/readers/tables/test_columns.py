"""Column names, units and columns texts: their meaning, and the errors for wrong ones."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from imucal.errors import ChoiceError
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.readers.tables.columns import NamedTable, parse_columns_text
from imucal.readers.tables.names import Role, parse_column
from imucal.readers.tables.plan import find_bare_triads, find_temperature, find_triads
from imucal.recording import Sensor
from imucal.units import SAMPLE_UNITS, TIME_UNITS_NS, parse_sample_unit, time_unit_ns
from tests.raising import raises
from tests.readers.tables.texts import N, cells, lines, seconds, truth, two_ardupilots, xyz

GYRO, ACCEL = Role.GYROSCOPE, Role.ACCELEROMETER


@pytest.mark.parametrize(
    ("header", "role", "index", "unit"),
    [
        ("w_RS_S_x [rad s^-1]", GYRO, 0, "rad s^-1"),
        ("a_RS_S_z [m s^-2]", ACCEL, 2, "m s^-2"),
        ("field.angular_velocity.y", GYRO, 1, None),
        ("/imu/data/linear_acceleration/x", ACCEL, 0, None),
        ("gyro_rad[2]", GYRO, 2, "rad/s"),
        ("accelerometer_m_s2[1]", ACCEL, 1, "m/s^2"),
        ("GyrX", GYRO, 0, None),
        ("AccZ", ACCEL, 2, None),
        ("Gyroscope X (deg/s)", GYRO, 0, "deg/s"),
        ("Low_Noise_Accelerometer_Y_CAL", ACCEL, 1, None),
        ("xRate", GYRO, 0, None),
        ("X Accel [x8004]", ACCEL, 0, None),
        ("gx", GYRO, 0, None),
        ("gx_deg_s", GYRO, 0, "deg/s"),
        ("az_g", ACCEL, 2, "g"),
        ("wz(deg/s)", GYRO, 2, "deg/s"),
        ("ax(g)", ACCEL, 0, "g"),
        ("G_X [mdps]", GYRO, 0, "mdps"),
        ("gyroy", GYRO, 1, None),
        ("xgyro", GYRO, 0, None),
        ("roll_rate", GYRO, 0, None),
        ("pitch_rate", GYRO, 1, None),
        ("yaw_rate", GYRO, 2, None),
        ("rollrate", GYRO, 0, None),
        ("pitchrate", GYRO, 1, None),
        ("yawrate", GYRO, 2, None),
        ("gyro_yaw", GYRO, 2, None),
        ("angular_pitch", GYRO, 1, None),
        ("roll", Role.OTHER, None, None),
        ("roll_acc", Role.OTHER, None, None),
        ("UnCompAccX", ACCEL, 0, None),
        ("accelerometerAccelerationX(G)", ACCEL, 0, "G"),
        ("Acc(x)", ACCEL, 0, None),
        ("x-axis (g)", ACCEL, 0, "g"),
        ("x", Role.VECTOR, 0, None),
        ("3DOF_y", Role.VECTOR, 1, None),
        ("FreeAcc_X", Role.OTHER, 0, None),
        ("motionUserAccelerationX(G)", Role.OTHER, 0, "G"),
        ("Magnetometer X (G)", Role.OTHER, 0, "G"),
        ("gyro_bias[0]", Role.OTHER, 0, None),
        ("estLinearAccelX", Role.OTHER, 0, None),
        ("field.angular_velocity_covariance0", Role.OTHER, None, None),
        ("orientation.x", Role.OTHER, 0, None),
        ("velocity_x", Role.OTHER, 0, None),
        ("alpha_x", Role.OTHER, 0, None),
        ("gx [g]", Role.OTHER, 0, "g"),
        ("acc_x (deg/s)", Role.OTHER, 0, "deg/s"),
        ("#timestamp [ns]", Role.TIME, None, "ns"),
        ("%time", Role.TIME, None, None),
        ("SampleTimeFine", Role.TIME, None, None),
        ("TimeUS", Role.TIME, None, "us"),
        ("t", Role.TIME, None, None),
        ("T", Role.TEMPERATURE, None, None),
        ("time_2", Role.TIME, None, None),
        ("gyro_time_1", Role.TIME, None, None),
        ("temp_c", Role.TEMPERATURE, None, "degC"),
        ("temp [K]", Role.TEMPERATURE, None, "K"),
        ("temp [g]", Role.OTHER, None, "g"),
        ("T [°C]", Role.TEMPERATURE, None, "°C"),
        ("gyro_1", GYRO, 1, None),
        ("gyro_1_raw", Role.OTHER, None, None),
        ("gyro_3", GYRO, 3, None),
        ("gyro_4", Role.OTHER, None, None),
        ("gyro[12]", Role.OTHER, None, None),
        ("gyro_x_rad_per_sec", GYRO, 0, "rad/s"),
        ("gyro_x_rad", GYRO, 0, "rad/s"),
        ("acc_x_m_s_2", ACCEL, 0, "m/s^2"),
        ("acc_x_m_per_s2", ACCEL, 0, "m/s^2"),
        ("acc_x_mg", ACCEL, 0, "mg"),
        ("time_sec", Role.TIME, None, "sec"),
        ("time [g]", Role.OTHER, None, "g"),
        ("gyro_x_ms", GYRO, 0, None),
        ("data_x_s", Role.OTHER, 0, None),
        ("tilt", Role.OTHER, None, None),
        ("heading [°]", Role.OTHER, None, "°"),
        ("gps_count", Role.OTHER, None, None),
        ("packet_id", Role.OTHER, None, None),
        ("T(°)", Role.TEMPERATURE, None, "°"),
        ("imu_temp", Role.TEMPERATURE, None, None),
        ("PacketCounter", Role.COUNTER, None, None),
        ("n_samples", Role.COUNTER, None, None),
        ("gyro_integral_dt", Role.OTHER, None, None),
        ("accelerometer_timestamp_relative", Role.OTHER, None, None),
    ],
)
def test_a_column_name_gives_role_axis_and_unit(
    header: str, role: Role, index: int | None, unit: str | None
) -> None:
    """A column name gives sensor, axis and unit; names of other quantities get another role."""
    column = parse_column(header, 0)
    assert (column.role, column.axis, column.unit) == (role, index, unit)


def test_alpha_is_an_acceleration_only_next_to_omega() -> None:
    """Kalibr writes `alpha` for the acceleration; elsewhere the name can mean anything."""
    assert parse_column("alpha_x", 4, context=frozenset({"omega_x", "alpha_x"})).role is ACCEL
    assert parse_column("alpha_x", 4, context=frozenset({"time", "alpha_x"})).role is Role.OTHER
    assert parse_column("p", 4, context=frozenset({"p", "q", "r"})).role is GYRO
    assert parse_column("p", 4, context=frozenset({"p", "q"})).role is Role.OTHER


def named(*headers: str, rows: Sequence[Sequence[str]] = ()) -> NamedTable:
    """Return a table with the given column names."""
    columns = tuple(
        parse_column(header, index, cells=[row[index] for row in rows])
        for index, header in enumerate(headers)
    )
    return NamedTable(path="log.csv", columns=columns)


@pytest.mark.parametrize(
    ("headers", "places"),
    [
        (("gyro_1", "gyro_2", "gyro_3"), ["g=0:3"]),
        (("gyro_0", "gyro_1", "gyro_2"), ["g=0:3"]),
        (("gyro_3", "gyro_2", "gyro_1"), ["g=2+1+0"]),
        (("gyro_0", "gyro_1", "gyro_3"), []),
        (("gyro_x", "t", "gyro_y", "gyro_z"), ["g=0+2+3"]),
        (("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z"), ["g=3:6", "a=0:3"]),
        (("lin_acc_x", "lin_acc_y", "lin_acc_z"), ["a=0:3"]),
        (("lin_acc_x", "lin_acc_y", "lin_acc_z", "gyro_x", "gyro_y", "gyro_z"), ["g=3:6", "a=0:3"]),
        (("lin_acc_x", "lin_acc_y", "lin_acc_z", "acc_x", "acc_y", "acc_z"), ["a=3:6"]),
    ],
)
def test_three_axes_are_found_by_name(headers: tuple[str, ...], places: list[str]) -> None:
    """Axes have letters, or numbers from 0 or 1.

    The gyroscope comes first, and acceleration with gravity is preferred to acceleration without.
    """
    assert [triad.text() for triad in find_triads(named(*headers))] == places


@pytest.mark.parametrize(
    ("tags", "gyro", "accel"),
    [
        (("gyro", "accel"), "gyro", "accel"),
        (("gyro", "7"), "gyro", "accel"),
        (("ACC", "7"), "GYR", "ACC"),
        (("Gyroscope", ""), "Gyroscope", "Accelerometer"),
        (("GyrX", "7"), "GyrX", None),
        (("accX", "7"), None, "accX"),
    ],
)
def test_one_usual_tag_identifies_both_sensors(
    tags: tuple[str, str], gyro: str | None, accel: str | None
) -> None:
    """If one tag has a usual name, the other tag belongs to the other sensor."""
    table = named("tag", "x", "y", "z", rows=[(f"'{tag}'", "1", "2", "3") for tag in tags])
    found, how = find_bare_triads(table, "log.csv")
    tags_of = {Sensor.GYROSCOPE: gyro, Sensor.ACCELEROMETER: accel}
    assert {s: triad.rows for s, triad in found.items()} == {s: (0, tag) for s, tag in tags_of.items() if tag}
    assert how == "by the tags of column tag"


def test_tags_of_two_gyroscopes_are_not_guessed() -> None:
    """The user must choose; the error offers the columns texts."""
    table = named("tag", "x", "y", "z", rows=[(tag, "1", "2", "3") for tag in ("gyro2", "gyro1", "acc")])
    with raises(
        ChoiceError,
        r"gyro1, gyro2.*such as g=1:4@gyro1,a=1:4@acc or g=1:4@gyro2,a=",
        place="log.csv",
        argument="columns",
    ):
        find_bare_triads(table, "log.csv")


def test_the_file_name_identifies_the_sensor() -> None:
    """The name is used only if the file name contains one sensor."""
    assert find_bare_triads(named("t", "x", "y"), "gyro.csv") == ({}, "")
    gyro, accel = Sensor
    for name, sensor in (
        ("MyGyro.csv", gyro),
        ("rotation_rate.csv", gyro),
        ("angular.csv", gyro),
        ("Acc.csv", accel),
    ):
        found, how = find_bare_triads(named("x", "y", "z"), name)
        assert ([*found], how) == ([sensor], "by the name of the file")
    for name in ("accuracy.csv", "gyro_acc.csv"):
        with raises(ChoiceError, "no sensor in their names", place="log.csv", argument="columns"):
            find_bare_triads(named("x", "y", "z"), name)


def test_the_temperature_column_nearest_to_the_sensor_is_used() -> None:
    """Without a sensor, the first temperature column is used."""
    columns = named("temp1", "gx", "gy", "gz", "t", "temp2").columns
    assert [find_temperature(columns, near=near) for near in ((1, 2, 3), (3,), ())] == [0, 5, 0]
    assert find_temperature(columns[1:5]) is None


@pytest.mark.parametrize(
    ("text", "name"),
    [
        *(
            (text, "rad/s")
            for text in ("rad/s", "[rad s^-1]", "rad_s", "rads", "rad/sec", "rad·s⁻¹", "radians per second")
        ),
        *(
            (text, "deg/s")
            for text in ("deg/s", "°/s", "º/s", "Â°/s", "dps", "deg_s", "degrees/second", "[deg/s]")
        ),
        *((text, "mdeg/s") for text in ("mdps", "mdeg/s")),
        *(
            (text, "m/s^2")
            for text in ("m/s^2", "m/s²", "m/sÂ²", "m s^-2", "m/(s^2)", "m_s2", "mps2", "m/s/s", "m·s⁻²")
        ),
        *((text, "g") for text in ("g", "G", "gs")),
        *((text, "mg") for text in ("mg", "milli-g")),
        *((text, "ug") for text in ("ug", "µg", "μg")),
    ],
)
def test_each_spelling_of_a_sample_unit_has_one_name(text: str, name: str) -> None:
    parsed = parse_sample_unit(text)
    assert parsed is not None
    assert parsed[1] == name
    assert name in SAMPLE_UNITS[parsed[0]]


@pytest.mark.parametrize("text", ["", "s", "uT", "deg", "rad", "m/s", "N", "V", "%"])
def test_units_of_other_quantities_are_not_sample_units(text: str) -> None:
    """An angle or a magnetic field is neither a rate nor an acceleration."""
    assert parse_sample_unit(text) is None


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("s", "s"),
        ("(sec)", "s"),
        ("ms", "ms"),
        ("msec", "ms"),
        ("µs", "us"),
        ("usec", "us"),
        ("[ns]", "ns"),
        ("g", None),
        ("ticks", None),
    ],
)
def test_each_spelling_of_a_time_unit_has_one_name(text: str, name: str | None) -> None:
    assert time_unit_ns(text) == TIME_UNITS_NS.get(name or "")


HEADERS = ["stamp", "wx", "wy", "wz", "ax", "ay", "az", "I", "temp"]


@pytest.mark.parametrize(
    "text",
    [
        "t=0,g=1:4,a=4:7",
        "t=stamp,g=wx+wy+wz,a=ax+ay+az",
        " time = 0 , gyro = 1+2+3 , accel = 4:7 ",
    ],
)
def test_a_columns_text_contains_column_numbers_or_names(text: str) -> None:
    """Ranges of numbers start at 0 and exclude their end; names are joined by "+"."""
    sensors, time, _ = parse_columns_text(text, named(*HEADERS))
    assert (time, [spec.indices for spec in sensors]) == ((0,), [(1, 2, 3), (4, 5, 6)])


def test_a_columns_text_can_select_rows_and_a_temperature() -> None:
    """Rows are selected by a tag, or by a column and its value. The axes can be in any order."""
    (gyro, accel), time, temperature = parse_columns_text(
        "g=3+2+1@imu,a=4:7@I:0,temp=8,t=0+7", named(*HEADERS)
    )
    assert (gyro.indices, gyro.rows) == ((3, 2, 1), (-1, "imu"))
    assert (accel.indices, accel.rows) == ((4, 5, 6), (7, "0"))
    assert (temperature, time) == (8, (0, 7))


@pytest.mark.parametrize(
    ("text", "axes", "indices"),
    [
        ("t=0,gz=3", ["gyro_z"], [3]),
        ("accel_z=6,gx=1,gz=3,ay=5", ["gyro_x", "gyro_z", "accel_y", "accel_z"], [1, 3, 5, 6]),
    ],
)
def test_a_columns_text_can_name_single_axes(text: str, axes: list[str], indices: list[int]) -> None:
    """The result is sorted: gyroscope first, then x, y, z."""
    sensors, _, _ = parse_columns_text(text, named(*HEADERS))
    assert [f"{spec.sensor.short}_{axis}" for spec in sensors for axis in spec.axes] == axes
    assert [index for spec in sensors for index in spec.indices] == indices


def test_both_sensors_can_use_the_same_columns_in_different_rows() -> None:
    (gyro, accel), _, _ = parse_columns_text("g=1:4@I:0,a=1:4@I:1", named(*HEADERS))
    assert gyro.indices == accel.indices
    assert (gyro.rows, accel.rows) == ((7, "0"), (7, "1"))


FOUND = (
    "found columns: 0 stamp, 1 wx, 2 wy, 3 wz, 4 ax, 5 ay, 6 az, 7 I, 8 temp; name them in a columns text "
    "of the form t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their numbers from 0)"
)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("t=0", "names neither gyroscope (g) nor accelerometer (a)"),
        ("g=1:3", "g names 2 columns, expected 3; for one axis write gz=1"),
        ("a=1", "a names 1 columns, expected 3; for one axis write az=1"),
        ("g=1+1+1", "column 1 is named twice; for a log of one axis give gz=1 alone"),
        ("g=wx+wy+wx", "column 1 is named twice; for a log of one axis give gz=1 alone"),
        ("g=1:4,a=3:6", "column 3 is named twice; for a log of one axis give gz=3 alone"),
        ("t=1,g=1:4", "column 1 is named twice; for a log of one axis give gz=1 alone"),
        ("g=1:4@I:0,a=1:4@I:0", "column 1 is named twice; for a log of one axis give gz=1 alone"),
        ("g=1:4@I:0,a=1:4", "column 1 is named twice; for a log of one axis give gz=1 alone"),
        ("gx=1,gy=1", "column 1 is named twice; for a log of one axis give gz=1 alone"),
        ("g=1:4,g=4:7", "g is named twice"),
        ("g=1:4,gz=5", "gz is one of the three columns of g; name one of them"),
        ("gz=1:3", "gz takes one column"),
        ("gx=1@a,gz=2@b", "gx and gz are of different rows; expected the same"),
        ("g=7:10", "there is no column 9; the last is 8"),
        ("g=wx+wy+foo", "there is no column 'foo'"),
        ("q=1:4", "'q=1:4' is not t=…, g=…, a=…, gx=… to az=…, or temp=…"),
        ("g", "'g' is not t=…, g=…, a=…, gx=… to az=…, or temp=…"),
        ("g=1:4,t=0+1+2+3", "t takes up to three columns and temp takes one"),
        ("g=1:999999999999", "g names 12 columns, expected 3"),
    ],
)
def test_a_wrong_columns_text_is_refused(text: str, problem: str) -> None:
    """The error explains the problem, lists the columns and shows the correct form."""
    with pytest.raises(ChoiceError) as caught:
        parse_columns_text(text, named(*HEADERS))
    message = str(caught.value)
    if "999" in text:
        assert "there is no column" in message
    else:
        assert message == f"log.csv: columns text {text!r}: {problem}; {FOUND}"


def refused(folder: Path, content: str, name: str = "log.csv", **options: object) -> str:
    """Return the error message without the path."""
    path = folder / name
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions(**options))  # type: ignore[arg-type]
    assert caught.value.place == str(path)
    return caught.value.sentence


def listed(content: str) -> str:
    """Return the columns of a text as an error lists them: names and first values."""
    header, first = (line.split(",") for line in content.split("\n")[:2])
    values = [cell if len(cell) < 10 else f"{float(cell):.6g}" for cell in first]
    return ", ".join(
        f"{at} {name} = {value}" for at, (name, value) in enumerate(zip(header, values, strict=True))
    )


HOW = "(numbers from 0 without the end, or three names joined by +)"


def test_a_table_without_header_is_refused(tmp_path: Path) -> None:
    """The order of the columns is never guessed. The error lists the columns with their first values."""
    content = lines("", seconds(truth()), *xyz(truth().accel), *xyz(truth().gyro), mark=" ")
    first = [cell if len(cell) < 10 else f"{float(cell):.6g}" for cell in content.split("\n")[0].split()]
    row = ", ".join(f"{i} = {cell}" for i, cell in enumerate(first))
    assert refused(tmp_path, content) == (
        "the 7 columns have no header; found columns: "
        f"{row}; name them in a columns text of the form t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their "
        "numbers from 0)"
    )


def test_thirty_columns_alone_do_not_identify_kitti(tmp_path: Path) -> None:
    content = lines("", *[cells(truth().accel[:, 2] * 100)] * 30, mark=" ")
    assert refused(tmp_path, content).startswith("the 30 columns have no header;")


def test_a_columns_text_can_select_rows_by_tag(tmp_path: Path) -> None:
    """The table has tagged rows and no header. The error shows one of the tags."""
    t = truth()
    rows = []
    for i in range(N):
        for tag, values in (("Gyroscope", t.deg[i]), ("Accelerometer", t.g[i])):
            rows.append(",".join([tag, str(1000 + 10 * i), *cells(values)]))
    content = "\n".join(rows) + "\n"
    columns = "t=1,g=2:5@Gyroscope,a=2:5@Accelerometer"
    assert "found columns: 0 = Gyroscope, 1 = 1000, " in refused(tmp_path, content)
    recording = read(tmp_path / "log.csv", ReadOptions(columns=columns, gyro_unit="deg/s"))
    assert [series.n for series in recording.series] == [N] * 6
    assert recording.axis("accelerometer", "z").samples[0] == pytest.approx(t.accel[0, 2], rel=1e-12)


def test_a_table_without_sensor_columns_is_refused(tmp_path: Path) -> None:
    """The error lists the columns."""
    content = lines("time (s),lat,lon,alt", seconds(truth()), *xyz(truth().gyro))
    assert refused(tmp_path, content) == (
        "no column has the name of a gyroscope or accelerometer axis; "
        f"found columns: {listed(content)}; name them in a columns text of the form "
        "t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their numbers from 0)"
    )


def test_two_axes_of_three_are_refused(tmp_path: Path) -> None:
    """The axes have numbers, so it is unknown which axis is missing."""
    content = lines("time (s),gyro_1,gyro_2,foo", seconds(truth()), *xyz(truth().gyro))
    assert refused(tmp_path, content) == (
        "expected x, y and z of one sensor, found only gyro_1 (gyroscope), gyro_2 (gyroscope); "
        f"found columns: {listed(content)}; name them in a columns text of the "
        "form t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their numbers from 0)"
    )


def test_axes_with_different_units_are_refused(tmp_path: Path) -> None:
    """A real logger writes xRate in rad/s and yRate in deg/s: one of the two units is wrong."""
    header = "time (s),xRate (rad/s),yRate (deg/s),zRate (deg/s)"
    content = lines(header, seconds(truth()), *xyz(truth().gyro))
    assert refused(tmp_path, content) == (
        "the axes of the gyroscope have different units (xRate (rad/s) in rad/s, yRate (deg/s) in deg/s, "
        "zRate (deg/s) in deg/s); expected one unit; "
        f"found columns: {listed(content)}; give the unit of the gyroscope, or correct the header"
    )
    recording = read(tmp_path / "log.csv", ReadOptions(gyro_unit="rad/s"))
    assert recording.series[0].samples[0] == truth().gyro[0, 0]


def test_two_sets_of_gyroscope_columns_are_refused(tmp_path: Path) -> None:
    """The user must choose; the error offers the columns texts."""
    header = "t,gyroADC[0],gyroADC[1],gyroADC[2],gyroUnfilt[0],gyroUnfilt[1],gyroUnfilt[2]"
    content = lines(header, seconds(truth()), *xyz(truth().gyro), *xyz(truth().gyro))
    path = tmp_path / "log.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions())
    assert caught.value.sentence == (
        f"2 sets of gyroscope columns: gyroADC[0], gyroUnfilt[0]; found columns: {listed(content)}; name "
        f"them in a columns text such as t=0,g=1:4 or t=0,g=4:7 {HOW}"
    )


def test_repeated_column_names_are_refused(tmp_path: Path) -> None:
    header = "time (s),gx,gy,gz,gx,gy,gz"
    content = lines(header, seconds(truth()), *xyz(truth().gyro), *xyz(truth().gyro))
    assert refused(tmp_path, content).startswith(
        "columns 1 and 4 have the same name, 'gx'; found columns: 0 time (s) = 0.000000, 1 gx = "
    )


def test_a_table_with_rows_of_two_sensors_is_refused(tmp_path: Path) -> None:
    """ArduPilot logs several IMUs in one table; column I contains their number."""
    message = refused(tmp_path, two_ardupilots(truth()))
    assert message.startswith(
        "rows of 2 sensors, numbered by column I (0, 1); found columns: 0 TimeUS = 1000000, 1 I = 0, "
    )
    assert message.endswith(f"such as t=0,g=2:5@I:0,a=5:8@I:0 or t=0,g=2:5@I:1,a=5:8@I:1 {HOW}")


def test_x_y_z_without_a_sensor_name_are_refused(tmp_path: Path) -> None:
    """Without units or a file name with a sensor, they could be either sensor."""
    content = lines("time,x,y,z", seconds(truth()), *xyz(truth().gyro))
    assert refused(tmp_path, content) == (
        f"x, y and z (x, y, z) have no sensor in their names; found columns: {listed(content)}; "
        f"name them in a columns text such as t=0,g=1:4 or t=0,a=1:4 {HOW}"
    )


def test_acceleration_with_gravity_is_preferred_to_linear_acceleration(tmp_path: Path) -> None:
    """Phones estimate linear acceleration without gravity; ROS uses the same name for the measurement."""
    header = "time (s)," + ",".join(
        f"{kind} {a} (m/s^2)" for kind in ("linear acceleration", "acceleration") for a in "XYZ"
    )
    content = lines(header, seconds(truth()), *xyz(truth().gyro), *xyz(truth().accel))
    path = tmp_path / "log.csv"
    path.write_text(content, encoding="utf-8")
    recording = read(path, ReadOptions())
    assert [series.name for series in recording.series] == ["accel_x", "accel_y", "accel_z"]
    assert recording.series[0].samples[0] == truth().accel[0, 0]


def test_time_is_never_the_temperature(tmp_path: Path) -> None:
    """A column T without a time column is a temperature, so the sampling rate is required."""
    header = "T,gx (rad/s),gy (rad/s),gz (rad/s)"
    content = lines(header, ["25.5"] * N, *xyz(truth().gyro))
    assert refused(tmp_path, content) == (
        "no time column and no sampling rate for the gyroscope; expected time stamps or a rate; "
        "give the sampling rate"
    )
    recording = read(tmp_path / "log.csv", ReadOptions(rate_hz=100.0))
    assert recording.temperature is not None


def test_contradicting_options_are_refused(tmp_path: Path) -> None:
    """Unit and scale exclude each other, and a unit must belong to the sensor."""
    content = lines("time (s),gx,gy,gz", seconds(truth()), *xyz(truth().gyro))
    assert refused(tmp_path, content, gyro_unit="deg/s", gyro_scale=0.1) == (
        "both a unit (deg/s) and a scale (0.1) are given for the gyroscope; give one"
    )
    assert refused(tmp_path, content, gyro_unit="g") == (
        "'g' is not a unit of the gyroscope; expected one such as rad/s, deg/s, mdeg/s or deg/h"
    )
    assert refused(tmp_path, content, time="foo") == (
        f"there is no time column 'foo'; found columns: {listed(content)}"
    )


def test_a_given_unit_overrides_the_header(tmp_path: Path) -> None:
    """Headers can be wrong; the report shows that the unit was given."""
    header = "time (s),gx (rad/s),gy (rad/s),gz (rad/s)"
    path = tmp_path / "log.csv"
    path.write_text(
        lines(header, seconds(truth()), *[cells(truth().deg[:, i]) for i in range(3)]), encoding="utf-8"
    )
    recording = read(path, ReadOptions(gyro_unit="dps"))
    assert recording.series[0].samples[0] == pytest.approx(truth().gyro[0, 0], rel=1e-12)
    assert dict(recording.source.decisions)[f"{Sensor.GYROSCOPE} unit"] == "deg/s, as given"

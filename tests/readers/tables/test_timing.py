"""The choice of the time column: the score of names and cells, and columns that belong together."""

from collections.abc import Mapping

import pytest

from imucal.errors import ChoiceError
from imucal.readers.tables.columns import NamedTable
from imucal.readers.tables.dialects import Dialect
from imucal.readers.tables.names import parse_column
from imucal.readers.tables.stamps import TimeChoice, _score, choose_times, named_time, time_of_columns
from imucal.recording import Sensor
from tests.raising import raises

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
#: Three increasing stamps, with no more digits than a counter has.
ON = ("1", "2", "3")


def table(columns: Mapping[str, tuple[str, ...]], dialect: Dialect | None = None) -> NamedTable:
    """Return a table with the given columns and their first cells."""
    entries = enumerate(columns.items())
    named = tuple(parse_column(name, index, cells=cells) for index, (name, cells) in entries)
    return NamedTable(path="log.csv", columns=named, dialect=dialect)


def offered(
    columns: Mapping[str, tuple[str, ...]], sensor: Sensor = GYRO
) -> list[tuple[str, str, int | None]]:
    return [(choice.kind, choice.name, choice.ns) for choice in choose_times(table(columns), sensor)]


@pytest.mark.parametrize(
    ("name", "score"),
    [
        ("stamp", 75),
        ("timestamp", 75),
        ("timestamp2", 75),
        ("timestamp [ms]", 77),
        ("time", 65),
        ("chiptime", 65),
        ("t", 62),
        ("ts", 62),
        ("ustime", 62),
        ("mstime", 62),
        ("uptime", 55),
        ("elapsed", 55),
        ("tick", 50),
        ("ticks", 50),
        ("tow", 60),
        ("epoch", 40),
        ("log_time", 25),
        ("logging_time", 25),
        ("host_time", 25),
        ("receive_time", 25),
        ("received_time", 25),
        ("recv_time", 25),
        ("rosbag_timestamp", 45),
        ("utc_time", 60),
        ("startup_time", 60),
        ("header_time", 80),
        ("hw_time", 77),
        ("device_time", 73),
        ("sensor_time", 73),
        ("fine_time", 70),
        ("gyro_time", 95),
        ("angular_time", 95),
        ("gyro_accel_time", 95),
        ("accel_time", -1),
        ("mag_time", 30),
        ("motion_time", 30),
        ("baro_time", 30),
        ("image_time", 30),
        ("cam_time", 30),
        # Times of another sensor, or of a separate clock.
        ("gps_time", 20),
    ],
)
def test_the_name_of_a_time_column_gives_its_score(name: str, score: float) -> None:
    """Stamps are better than times, and the sensor's clock is better than the computer's.

    Times of other sensors are excluded.
    """
    assert _score(parse_column(name, 0, cells=ON), GYRO) == score


@pytest.mark.parametrize(
    ("cells", "score"),
    [
        ((), 65),
        (("", ""), 65),
        (("7",), 65),
        (("7", "7"), 5),
        (("7", "", "7"), 5),
        (("7", "8"), 65),
        (("2024-01-01T00:00:00", "2024-01-01T00:00:01"), 35),
        (("'7'", "'8'"), 65),
        (("1" * 17, "2" * 17), 65),
        (("1" * 18, "2" * 18), 75),
        (("-" + "1" * 18, "2" * 18), 75),
        (("1" * 18, "2" * 17), 65),
        (("1" * 16 + ".5", "2" * 16 + ".5"), 65),
    ],
)
def test_the_cells_of_a_time_column_change_its_score(cells: tuple[str, ...], score: float) -> None:
    """Nanoseconds since 1970 are better than other numbers, and numbers better than dates.

    Constant cells have the lowest score.
    """
    assert _score(parse_column("time", 0, cells=cells), GYRO) == score


def test_a_constant_time_of_another_sensor_is_not_preferred() -> None:
    """Constant cells do not raise a low score, and columns with a negative score are not offered."""
    assert _score(parse_column("gps_log_time", 0, cells=ON), GYRO) == -20
    assert _score(parse_column("gps_log_time", 0, cells=("7", "7")), GYRO) == -20
    assert offered({"gps_log_time": ON}) == []
    assert offered({"mag_log_timestamp": ON}) == []
    assert offered({"mag_log_timestamp [ms]": ON}) == [("stamp", "mag_log_timestamp [ms]", 10**6)]
    assert offered({"accel_time": ON}) == []
    assert [name for _, name, _ in offered({"accel_time": ON}, ACCEL)] == ["accel_time"]


def test_times_are_sorted_by_preference_with_counters_last() -> None:
    """Equal scores keep the order of the table."""
    columns = {"count": ON, "epoch": ON, "time": ("4", "4", "4"), "t": ON, "ts": ON, "timestamp": ON}
    assert [name for _, name, _ in offered(columns)] == ["timestamp", "t", "ts", "epoch", "time", "count"]


@pytest.mark.parametrize(
    ("columns", "kind", "name"),
    [
        ({"secs": ON, "nsecs": ON}, "pair", "secs+nsecs"),
        ({"nsecs": ON, "secs": ON}, "pair", "secs+nsecs"),
        ({"time [s]": ON, "time [ns]": ON}, "pair", "time [s]+time [ns]"),
        # The largest value below a second in ns.
        ({"secs": ON, "nsecs": ("1", "999999999")}, "pair", "secs+nsecs"),
        ({"secs": ON, "nsecs": ("1", "1000000000")}, "stamp", "secs"),
        # Only integers count; empty cells are ignored.
        ({"secs": ON, "nsecs": ("1", "", "3")}, "pair", "secs+nsecs"),
        ({"secs": ("1.5", "2.5"), "nsecs": ON}, "stamp", "secs"),
        ({"secs": ("", ""), "nsecs": ON}, "stamp", "nsecs"),
        # The names differ too much to belong together.
        ({"stamp_secs": ON, "log_nsecs": ON}, "stamp", "stamp_secs"),
        ({"header_secs": ON, "header_nsecs": ON, "secs": ON}, "pair", "header_secs+header_nsecs"),
        # A pair precedes the best stamp, unless its fraction is constant.
        ({"timestamp [ms]": ON, "secs": ON, "nsecs": ON}, "pair", "secs+nsecs"),
        ({"sensor_gyro_time": ON, "secs": ON, "nsecs": ON}, "stamp", "sensor_gyro_time"),
        ({"uptime": ON, "secs": ON, "nsecs": ("5", "5")}, "stamp", "uptime"),
        ({"uptime": ("5", "5"), "secs": ON, "nsecs": ("5", "5")}, "stamp", "uptime"),
        ({"count": ON, "secs": ON, "nsecs": ("5", "5")}, "pair", "secs+nsecs"),
        # The week is not added to a time of the week.
        ({"week": ON, "tow": ON}, "stamp", "tow"),
        ({"GPS Week": ON, "GPS TOW": ON}, "stamp", "GPS TOW"),
        ({"week": ON, "tow": ON, "ticks": ON}, "stamp", "tow"),
        ({"week": ON, "tow": ON, "ts": ON}, "stamp", "ts"),
        ({"week": ON, "time": ON}, "stamp", "time"),
        ({"tow": ON}, "stamp", "tow"),
    ],
)
def test_seconds_and_nanoseconds_form_one_time(
    columns: Mapping[str, tuple[str, ...]], kind: str, name: str
) -> None:
    assert offered(columns)[0][:2] == (kind, name)


DATE = ("year", "month", "day", "hour", "minute", "second")


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        (dict.fromkeys(DATE, ON), []),
        (dict.fromkeys((*DATE, "nano"), ON), []),
        (dict.fromkeys(DATE[3:], ON), []),
        (dict.fromkeys(("hour", "min", "sec"), ON), []),
        (dict.fromkeys(("min", "max", "sec"), ON), ["sec"]),
        (dict.fromkeys(DATE, ON) | {"utc_time": ON}, ["utc_time"]),
        (dict.fromkeys(DATE, ON) | {"uptime [s]": ON}, ["uptime [s]"]),
        ({"second": ON}, ["second"]),
    ],
)
def test_columns_of_a_date_are_joined(columns: Mapping[str, tuple[str, ...]], names: list[str]) -> None:
    """Seconds next to minutes restart every minute, so they are not a time of their own."""
    assert [name for _, name, _ in offered(columns)] == names


@pytest.mark.parametrize(
    ("cells", "there"),
    [
        (("1", "2", "3"), True),
        (("1", "2"), False),
        (("1", "1", "2", "3"), False),
        (("1", "2", "3", "4", "4"), True),
        (("7",), False),
        (("3", "2", "1"), False),
        (("1", "2", "x"), False),
    ],
)
def test_a_counter_increases_in_most_rows(cells: tuple[str, ...], there: bool) -> None:  # noqa: FBT001 - of the case
    assert offered({"count": cells}) == ([("counter", "count", None)] if there else [])


@pytest.mark.parametrize(
    ("name", "ns"),
    [
        ("time (s)", 10**9),
        ("time_ms", 10**6),
        ("TimeUS", 10**3),
        ("ustime", 10**3),
        ("mstime", 10**6),
        ("uptime", None),
        ("time", None),
        ("t", None),
    ],
)
def test_the_unit_of_a_time_is_read_from_its_name(name: str, ns: int | None) -> None:
    """The unit is in brackets, a separate word, or in front of `time`."""
    choice = choose_times(table({name: ON}), GYRO)[0]
    assert (choice.ns, choice.ns_source) == (ns, "from the column header" if ns else "")


def test_a_dialect_sets_the_units_of_its_columns() -> None:
    """The dialect overrides the units in the names of these columns."""
    known = Dialect(name="Ours", headers=(), time_ns=(("stamp", 100), ("time (us)", 7)))
    columns = {'"#stamp"': ON, "time (us)": ON, "time (ms)": ON}
    found = [time_of_columns(table(columns, known), [index]) for index in range(3)]
    assert [(choice.ns, choice.ns_source) for choice in found] == [
        (100, "as in logs of Ours"),
        (7, "as in logs of Ours"),
        (10**6, "from the column header"),
    ]


@pytest.mark.parametrize(
    ("cells", "kind"),
    [
        (("1", "2", "x", "y"), "stamp"),
        (("1", "x", "y"), None),
        (("", "1", "", ""), "stamp"),
        (("12:00:00", "12:00:01", "x", "y"), "text"),
        (("12:00:00", "x", "y"), None),
        (("'1'", '"2"'), "stamp"),
    ],
)
def test_half_of_the_cells_decide_the_kind_of_a_column(cells: tuple[str, ...], kind: str | None) -> None:
    """Numbers are tried first, then dates and times of day; empty cells are ignored."""
    named = table({"foo": cells})
    if kind is None:
        with raises(ChoiceError, r"column 0 \(foo\) is not a time", place="log.csv", argument="columns"):
            time_of_columns(named, [0])
    else:
        assert time_of_columns(named, [0]).kind == kind


def test_a_user_can_name_one_or_two_time_columns() -> None:
    """Two columns are seconds and their fraction; three columns are refused."""
    named = table({"a": ON, "b": ON, "count": ON, "": ON, "empty": ("", "")})
    pair = TimeChoice(kind="pair", indices=(0, 1), name="a+b", ns_source="seconds + a fraction")
    assert named_time(named, "a+b") == pair
    with raises(ChoiceError, "columns 0, 1, 2 are not a date", place="log.csv", argument="columns"):
        named_time(named, "a+b+count")
    assert named_time(named, "count") == TimeChoice(kind="counter", indices=(2,), name="count")
    assert time_of_columns(named, [3]).name == "3"
    with raises(ChoiceError, r"column 4 \(empty\) is not a time", place="log.csv", argument="columns"):
        time_of_columns(named, [4])

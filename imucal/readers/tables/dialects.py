"""Text dialects: how known programs and devices write their logs, where the header does not say it.

A new dialect is one entry of `DIALECTS`, about 5 lines; its test is one example in
`tests/readers/tables/texts.py`, about 7 lines; and `docs/formats.md` names it, a word. `test_dialects.py`
says which of these is missing. Only names that say no sensor to `names.py` need a word there as well.
"""

import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from imucal.readers.tables.layout import BLANKS, TextLayout, is_number, rows_of_tag, split_line
from imucal.recording import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """A way of writing a table of text. A unit in the header goes before the one given here.

    Attributes
    ----------
    name
        What people call it.
    headers
        Regular expressions; each must match the whole of some column's name, in small letters.
    preamble
        Regular expression that must be found in the lines before the header, or empty.
    gyro_unit, accel_unit
        Units of its samples; None where they differ from file to file.
    time_ns
        Name of a time column in small letters -> ns per count.
    has_log_time
        Whether the time of recording stands beside the sensor's own stamps.
    columns
        Names of the columns, where no header is written and the order is fixed; `headers` must match them.
    fits
        Whether a table without a header, as wide as `columns`, can be one of these.
    messages
        Finds the layout of a log whose lines are messages, from its first lines.
    """

    name: str
    headers: tuple[str, ...]
    preamble: str = ""
    gyro_unit: str | None = None
    accel_unit: str | None = None
    time_ns: tuple[tuple[str, int], ...] = ()
    has_log_time: bool = False
    columns: tuple[str, ...] = ()
    fits: Callable[[TextLayout], bool] | None = None
    messages: Callable[[Sequence[str]], TextLayout | None] | None = None

    def matches(self, headers: Sequence[str], preamble: str) -> bool:
        """Return whether a table with these columns and this preamble is written so."""
        if self.preamble and not re.search(self.preamble, preamble, re.IGNORECASE | re.MULTILINE):
            return False
        return all(any(re.fullmatch(pattern, name) for name in headers) for pattern in self.headers)

    def unit_of(self, sensor: Sensor) -> str | None:
        """Return the unit of a sensor's samples; None where it differs from file to file."""
        return self.gyro_unit if sensor is Sensor.GYROSCOPE else self.accel_unit


def find_dialect(headers: Sequence[str], preamble: Sequence[str] = ()) -> Dialect | None:
    """Return the dialect that a table's column names and preamble show, or None."""
    plain = [header.strip().strip("\"'").lstrip("#%/ ").lower() for header in headers]
    text = "\n".join(preamble)
    return next((dialect for dialect in DIALECTS if dialect.matches(plain, text)), None)


#: What would end a cell, or a row.
_NO_CELL = re.compile(r'[,"\n\r]')


def find_messages(lines: Sequence[str]) -> TextLayout | None:
    """Return the layout of a log whose lines are messages of a known dialect, or None."""
    finders = [_find_json, *(dialect.messages for dialect in DIALECTS if dialect.messages is not None)]
    return next((layout for find in finders if (layout := find(lines)) is not None), None)


def _cells_of(line: str) -> dict[str, str] | None:
    """Return the numbers and texts of a JSON object by their paths, as cells; None of anything else."""
    try:
        tree = json.loads(line, parse_float=str, parse_int=str, parse_constant=str)
    except (ValueError, RecursionError):
        return None
    return dict(_leaves(tree, "")) if isinstance(tree, dict) else None


def _leaves(tree: object, path: str) -> Iterator[tuple[str, str]]:
    if isinstance(tree, dict):
        for name, value in tree.items():
            yield from _leaves(value, f"{path}.{name}" if path else name)
    elif isinstance(tree, list):
        for at, value in enumerate(tree):
            yield from _leaves(value, f"{path}[{at}]")
    elif isinstance(tree, str):
        yield path, _NO_CELL.sub(" ", tree).strip()


def _find_json(lines: Sequence[str]) -> TextLayout | None:
    """Return the layout of a log with a JSON object in each line; its members are columns by their paths."""
    rows = [cells for line in lines if (cells := _cells_of(line))]
    if len(rows) < 2 or len(rows) < 0.5 * len(lines):
        return None
    headers = tuple(dict.fromkeys(name for row in rows for name in row))
    table = tuple(tuple(row.get(name, "") for name in headers) for row in rows)
    return TextLayout(
        width=len(headers), headers=headers, rows=table, prepare=partial(_json_rows, headers=headers)
    )


def _json_rows(block: bytes, headers: Sequence[str]) -> bytes:
    """Return the objects of a block as rows of cells; what is none stays as a row that no parser takes."""
    rows = []
    for line in filter(str.strip, block.decode("utf-8", "replace").split("\n")):
        cells = _cells_of(line)
        rows.append("no JSON object" if cells is None else ",".join(cells.get(name, "") for name in headers))
    return "\n".join([*rows, ""]).encode()


def name_columns(layout: TextLayout) -> TextLayout:
    """Return a layout without a header with the names of the dialect that it fits, if there is one."""
    if layout.headers or layout.mismatch is not None:
        return layout
    for dialect in DIALECTS:
        if layout.width == len(dialect.columns) and dialect.fits is not None and dialect.fits(layout):
            return replace(layout, headers=dialect.columns)
    return layout


#: `ros2 topic echo --csv` of sensor_msgs/msg/Imu: the fields of the message in their order.
_ROS2_IMU = (
    *("header.stamp.sec", "header.stamp.nanosec", "header.frame_id"),
    *(f"orientation.{axis}" for axis in "xyzw"),
    *(f"orientation_covariance.{i}" for i in range(9)),
    *(f"angular_velocity.{axis}" for axis in "xyz"),
    *(f"angular_velocity_covariance.{i}" for i in range(9)),
    *(f"linear_acceleration.{axis}" for axis in "xyz"),
    *(f"linear_acceleration_covariance.{i}" for i in range(9)),
)


def _is_ros2(layout: TextLayout) -> bool:
    """Return whether rows are two whole numbers, a text, and numbers only."""
    return all(
        len(row) == len(_ROS2_IMU)
        and not is_number(row[2])
        and (row[0] + row[1]).isdigit()
        and all(map(is_number, row[3:]))
        for row in layout.rows[:20]
    )


#: KITTI raw data, oxts/dataformat.txt.
_KITTI = (
    *("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu"),
    *("oxts ax", "oxts ay", "oxts az", "af", "al", "au"),
    *("oxts wx", "oxts wy", "oxts wz", "wf", "wl", "wu"),
    *("pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode", "orimode"),
)


def _is_kitti(layout: TextLayout) -> bool:
    """Return whether rows have a position on Earth, three angles, and five whole numbers at the end."""

    def is_row(row: Sequence[str]) -> bool:
        if not all(map(is_number, row)) or not all(cell.isdigit() for cell in row[-5:]):
            return False
        lat, lon, _, *angles = (abs(float(cell)) for cell in row[:6])
        return not (lat > 90 or lon > 180 or max(angles) > 2 * np.pi)

    return layout.delimiter == BLANKS and all(map(is_row, layout.rows[:20]))


#: A line of ArduPilot's text log that says which fields the IMU message has.
_FORMAT_LINE = re.compile(r"FMT,[^,]*,[^,]*,\s*(?P<tag>IMU)\s*,[^,]*,\s*(?P<names>.+)", re.IGNORECASE)


def _tagged(line: re.Pattern[str], lines: Sequence[str]) -> tuple[str, tuple[str, ...]] | None:
    """Return the tag of some rows and the names of their cells, as a line of the log says them."""
    match = next(filter(None, map(line.match, lines)), None)
    return (match["tag"], ("tag", *map(str.strip, match["names"].split(",")))) if match else None


def _find_ardupilot(lines: Sequence[str]) -> TextLayout | None:
    """Return the layout of the IMU rows of a text log of tagged rows, whose FMT lines name their fields."""
    found = _tagged(_FORMAT_LINE, lines)
    if found is None:
        return None
    tag, headers = (0, "IMU"), found[1]
    cells = [tuple(split_line(row, ",")) for row in rows_of_tag(lines, ",", tag)]
    rows = tuple(row for row in cells if len(row) == len(headers))
    return TextLayout(width=len(headers), headers=headers, rows=rows, tag=tag) if rows else None


#: Message with raw samples -> its fields. Source: VectorNav VN-100 user manual UM001, registers 27 and 54.
_VECTORNAV: dict[str, tuple[str, ...]] = {
    "VNYMR": (
        *("$VNYMR", "yaw", "pitch", "roll", "MagX", "MagY", "MagZ"),
        *("AccelX", "AccelY", "AccelZ", "GyroX", "GyroY", "GyroZ"),
    ),
    "VNIMU": (
        *("$VNIMU", "MagX", "MagY", "MagZ", "AccelX", "AccelY", "AccelZ"),
        *("GyroX", "GyroY", "GyroZ", "Temp", "Pressure"),
    ),
}

_SENTENCE = re.compile(r"\$(?P<name>VNYMR|VNIMU),")

#: What stands before a message, the message, and its checksum of two or four digits.
_CHECKED = re.compile(
    rb"(?m)^([^$\n]*)\$((?:VNYMR|VNIMU),[^*\n]*)\*([0-9A-Fa-f]{2})(?:[0-9A-Fa-f]{2})?[ \t]*$"
)


def _find_vectornav(lines: Sequence[str]) -> TextLayout | None:
    """Return the layout of a log of VectorNav's ASCII messages with raw samples.

    What stands in front of a message, such as the time of the computer that logged it, comes first.
    """
    matches = [match for line in lines if (match := _SENTENCE.search(line))]
    if len(matches) < 0.3 * sum(bool(line.strip()) for line in lines) or not matches:
        return None
    name = matches[0]["name"]
    before = split_line(matches[0].string[: matches[0].start()].rstrip(", \t"), ",")
    before = before if any(before) else []
    names = ["host time" if len(before) == 1 else f"prefix {i}" for i in range(len(before))]
    headers = (*names, *_VECTORNAV[name])
    cells = [split_line(m.string.partition("*")[0], ",") for m in matches if m["name"] == name]
    rows = tuple(tuple(row) for row in cells if len(row) == len(headers) and is_number(row[-1]))
    if not rows:
        return None
    return TextLayout(width=len(headers), headers=headers, rows=rows, prepare=_good_sentences)


def _good_sentences(block: bytes) -> bytes:
    """Return the messages of a block whose checksum is right, as rows of cells.

    A message with a wrong checksum stays as a row that no parser takes, so that it is counted.
    """
    lines = []
    for match in _CHECKED.finditer(block):
        before, sentence, checksum = match.groups()
        right = int(np.bitwise_xor.reduce(np.frombuffer(sentence, dtype=np.uint8))) == int(checksum, 16)
        lines.append(before + b"$" + sentence if right else b"wrong checksum")
    return b"\n".join(lines) + b"\n"


#: A comment of GnssLogger (Android) that names the fields of its rows of an inertial sensor.
_GNSS_LOGGER = re.compile(r"#\s*(?P<tag>(?:Uncal)?Gyro)\s*,(?P<names>\s*utcTimeMillis\s*,.*)")


def _find_gnss_logger(lines: Sequence[str]) -> TextLayout | None:
    """Return the layout of the rows of a gyroscope; those of the accelerometer have the same columns."""
    found = _tagged(_GNSS_LOGGER, lines)
    if found is None:
        return None
    tag, headers = found
    cells = [tuple(split_line(line, ",")) for line in lines]
    rows = [row for row in cells if row[0] in {tag, tag.replace("Gyro", "Accel")}]
    # Old versions wrote no biases: the rows are shorter than the comment says.
    width = min(map(len, rows), default=0)
    if not 6 <= width <= len(headers):
        return None
    comments = tuple(line for line in lines if line.startswith("#"))
    kept = tuple(row[:width] for row in rows)
    return TextLayout(width=width, headers=headers[:width], rows=kept, preamble=comments)


_SI: Any = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}
_ROS: Any = {"name": "ROS", **_SI, "has_log_time": True}

#: In the order in which they are tried.
DIALECTS: tuple[Dialect, ...] = (
    # EuRoC and TUM-VI data.csv; the header of the data sets has the units, copies often lost them.
    Dialect(name="EuRoC", headers=(r"w_rs_s_x.*", r"a_rs_s_x.*"), **_SI),
    # Kalibr's bagextractor and OpenVINS.
    Dialect(name="Kalibr", headers=(r"omega_x", r"alpha_x"), **_SI),
    # sensor_msgs/Imu: REP 103 and the message's own comments.
    Dialect(
        headers=(r"field\.header\.stamp", r"field\..*(angular_velocity|linear_acceleration)\.x"),
        time_ns=(("field.header.stamp", 1),),
        **_ROS,
    ),
    Dialect(headers=(r".*angular_velocity[./_ ]?x.*",), columns=_ROS2_IMU, fits=_is_ros2, **_ROS),
    Dialect(headers=(r".*linear_acceleration[./_ ]?x.*",), **_ROS),
    # Xsens DOT User Manual XD0502P: SampleTimeFine counts microseconds, Gyr is in deg/s.
    Dialect(
        name="Xsens DOT",
        headers=(r"gyr_x", r"acc_x"),
        preamble=r"^DeviceTag|^Measurement server",
        gyro_unit="deg/s",
        accel_unit="m/s^2",
        time_ns=(("sampletimefine", 1_000),),
    ),
    # Xsens MTi low-level protocol: SampleTimeFine counts 10 kHz ticks.
    Dialect(
        name="Xsens",
        headers=(r"gyr_x", r"acc_x", r"packetcounter|counter"),
        **_SI,
        time_ns=(("sampletimefine", 100_000),),
    ),
    Dialect(name="Xsens", headers=(r"gyr_x", r"acc_x"), preamble=r"^// ", **_SI),
    # GnssLogger for Android: rows of many sensors, whose fields comments name.
    Dialect(
        name="GnssLogger", headers=(r"tag", r"(uncal)?gyroxradpersec"), **_SI, messages=_find_gnss_logger
    ),
    # ArduPilot dataflash message IMU.
    Dialect(name="ArduPilot", headers=(r"timeus", r"gyrx", r"accx"), **_SI, messages=_find_ardupilot),
    # PX4 sensor_combined, sensor_gyro and sensor_accel through ulog2csv: microseconds since boot.
    Dialect(name="PX4", headers=(r"timestamp", r"gyro_rad\[0\]"), **_SI, time_ns=(("timestamp", 1_000),)),
    Dialect(
        name="PX4",
        headers=(r"timestamp", r"timestamp_sample", r"device_id", r"x"),
        **_SI,
        time_ns=(("timestamp", 1_000), ("timestamp_sample", 1_000)),
    ),
    # Betaflight blackbox_decode: gyroADC in deg/s, accelerometer in raw counts.
    Dialect(
        name="Betaflight",
        headers=(r"loopiteration", r"gyroadc\[0\].*"),
        gyro_unit="deg/s",
        time_ns=(("time", 1_000), ("time (us)", 1_000)),
    ),
    # SensorLog for iOS: Core Motion gives g and rad/s.
    Dialect(
        name="SensorLog",
        headers=(r"accelerometeraccelerationx.*", r"gyrorotationx.*"),
        gyro_unit="rad/s",
        accel_unit="g",
    ),
    # librealsense: rs-data-collect.
    Dialect(name="RealSense", headers=(r"stream type", r"3dof_x"), **_SI),
    # Sensor Logger for Android and iOS.
    Dialect(name="Sensor Logger", headers=(r"time", r"seconds_elapsed", r"x", r"y", r"z"), **_SI),
    # MicroStrain: MIP descriptors 0x8004 scaled accelerometer (g), 0x8005 scaled gyroscope (rad/s).
    Dialect(name="MicroStrain", headers=(r"x accel \[x8004\]",), gyro_unit="rad/s", accel_unit="g"),
    Dialect(name="MicroStrain", headers=(r"scaledaccelx.*",), gyro_unit="rad/s", accel_unit="g"),
    # VectorNav Control Center and INSTINCT.
    Dialect(name="VectorNav", headers=(r"uncompgyrox|uncompaccx",), **_SI),
    Dialect(name="VectorNav", headers=(r"\$vn.*", r"gyrox", r"accelx"), **_SI, messages=_find_vectornav),
    # KITTI raw data: oxts/dataformat.txt.
    Dialect(name="KITTI", headers=(r"oxts wx", r"oxts ax"), **_SI, columns=_KITTI, fits=_is_kitti),
)

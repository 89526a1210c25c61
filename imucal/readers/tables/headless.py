"""Text tables without a header: the few whose makers fix the columns, and a proposal for the others.

A proposal is only ever shown: the magnitude of gravity finds the accelerometer of a narrow table at
rest, and is wrong on wide or moving ones.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucal.readers.tables.columns import Rows
from imucal.readers.tables.layout import BLANKS, Layout, find_layout, is_number, split_line
from imucal.units import G0

#: A columns text that shows how one is written.
_EXAMPLE = "t=0,g=1:4,a=4:7"

_VECTOR = ("x", "y", "z")

#: `ros2 topic echo --csv` of sensor_msgs/msg/Imu: the fields of the message in their order.
_ROS2_IMU = (
    *("header.stamp.sec", "header.stamp.nanosec", "header.frame_id"),
    *(f"orientation.{axis}" for axis in ("x", "y", "z", "w")),
    *(f"orientation_covariance.{i}" for i in range(9)),
    *(f"angular_velocity.{axis}" for axis in _VECTOR),
    *(f"angular_velocity_covariance.{i}" for i in range(9)),
    *(f"linear_acceleration.{axis}" for axis in _VECTOR),
    *(f"linear_acceleration_covariance.{i}" for i in range(9)),
)

#: KITTI raw data, oxts/dataformat.txt.
_KITTI = (
    *("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu"),
    *("oxts ax", "oxts ay", "oxts az", "af", "al", "au"),
    *("oxts wx", "oxts wy", "oxts wz", "wf", "wl", "wu"),
    *("pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode", "orimode"),
)

#: A line of ArduPilot's text log that says which fields the IMU message has.
_FORMAT_LINE = re.compile(r"FMT,[^,]*,[^,]*,\s*IMU\s*,[^,]*,\s*(?P<names>.+)", re.IGNORECASE)

#: A tag that marks the rows of an inertial sensor.
_INERTIAL = re.compile(
    r"\$?(imu|gyr|acc|raw_?imu|scaled_?imu|inertial|sensor_combined|ins)\w*", re.IGNORECASE
)


def named_columns(layout: Layout) -> Layout:
    """Return a layout with the names of a headerless format whose maker fixes its columns."""
    if layout.headers or layout.mismatch is not None:
        return layout
    if layout.width == len(_ROS2_IMU) and _is_ros2(layout):
        return replace(layout, headers=_ROS2_IMU)
    if layout.width == len(_KITTI) and layout.delimiter == BLANKS and _is_kitti(layout):
        return replace(layout, headers=_KITTI)
    return layout


def _is_ros2(layout: Layout) -> bool:
    """Return whether rows are Imu messages: text at the frame's place, a unit quaternion behind it."""
    for row in layout.rows[:20]:
        if len(row) != len(_ROS2_IMU) or is_number(row[2]) or not (row[0] + row[1]).isdigit():
            return False
        if not all(is_number(cell) for cell in row[3:]):
            return False
    return bool(layout.rows)


def _is_kitti(layout: Layout) -> bool:
    """Return whether rows have a place on Earth, three angles, and five whole numbers at the end."""
    for row in layout.rows[:20]:
        if not all(is_number(cell) for cell in row) or not all(cell.isdigit() for cell in row[-5:]):
            return False
        values = [abs(float(cell)) for cell in row[:6]]
        if values[0] > 90 or values[1] > 180 or max(values[3:6]) > 2 * np.pi:
            return False
    return bool(layout.rows)


def tagged_layout(lines: Sequence[str]) -> tuple[Layout, Rows] | None:
    """Return the layout of the IMU rows of a log of tagged rows that names their fields, and their tag.

    That is ArduPilot's text log: ``FMT`` lines name the fields of every message.
    """
    for line in lines:
        match = _FORMAT_LINE.match(line)
        if match:
            names = ("tag", *(name.strip() for name in match["names"].split(",")))
            rows = rows_of_tag(lines, ",", (0, "IMU"))
            cells = tuple(tuple(split_line(row, ",")) for row in rows)
            cells = tuple(row for row in cells if len(row) == len(names))
            if not cells:
                return None
            layout = Layout(
                delimiter=",",
                decimal=".",
                width=len(names),
                headers=names,
                units=(),
                preamble=(),
                start=0,
                rows=cells,
            )
            return layout, (0, "IMU")
    return None


def rows_of_tag(lines: Sequence[str], delimiter: str, rows: Rows) -> list[str]:
    """Return the lines whose cell holds a tag."""
    if rows is None:
        return list(lines)
    place, tag = rows
    found = []
    for line in lines:
        cells = [cell.strip("\"'") for cell in split_line(line, delimiter)]
        if tag in cells if place < 0 else place < len(cells) and cells[place] == tag:
            found.append(line)
    return found


def propose_columns(lines: Sequence[str], layout: Layout) -> str:
    """Return a columns text to start from, for a table without a header."""
    tags = _inertial_tags(lines, layout.delimiter)
    gyro = next((tag for tag in tags if tag.lower().startswith("gyr")), None)
    accel_tag = next((tag for tag in tags if tag.lower().startswith("acc")), None)
    tag, suffix = (tags[0] if tags else None), ""
    if tag is not None:
        suffix = f"@{tag}"
        layout = find_layout(rows_of_tag(lines, layout.delimiter, (-1, tag))) or layout
    numeric = [place for place in range(layout.width) if _is_numeric(layout, place)]
    if len(numeric) < 3:
        return _EXAMPLE
    table = np.array(
        [[float(layout.cells(place)[i]) for place in numeric] for i in range(len(layout.rows))],
        dtype=np.float64,
    )
    time = _time_place(table)
    if gyro is not None and accel_tag is not None and len(numeric) == 4 and time == 0:
        place = f"{numeric[1]}:{numeric[1] + 3}"
        return f"t={numeric[0]},g={place}@{gyro},a={place}@{accel_tag}"
    accel = _gravity(table, time) if len(numeric) <= 8 else None
    return _text(numeric, time, accel, suffix)


def _text(numeric: Sequence[int], time: int | None, accel: int | None, suffix: str) -> str:
    """Return the columns text: time, the accelerometer where gravity showed it, the gyroscope beside it."""
    free = [i for i in range(len(numeric)) if i != time]
    starts = [i for i in free if {i, i + 1, i + 2} <= set(free) and numeric[i + 2] == numeric[i] + 2]
    if accel is not None:
        starts = [i for i in starts if abs(i - accel) >= 3]
        gyro = next((i for i in starts if abs(i - accel) == 3), starts[0] if starts else None)
    else:
        gyro = starts[0] if starts else None
        accel = next((i for i in starts if gyro is not None and i >= gyro + 3), None)
    parts = [f"t={numeric[time]}"] if time is not None else []
    for key, first in (("g", gyro), ("a", accel)):
        if first is not None:
            parts.append(f"{key}={numeric[first]}:{numeric[first] + 3}{suffix}")
    return ",".join(parts) if gyro is not None or accel is not None else _EXAMPLE


def _is_numeric(layout: Layout, place: int) -> bool:
    cells = layout.cells(place)
    return len(cells) == len(layout.rows) and bool(cells) and all(is_number(cell) for cell in cells)


def _gravity(table: np.ndarray[tuple[int, int], np.dtype[np.float64]], time: int | None) -> int | None:
    """Return the first column of the only triad with the magnitude of gravity, time left out."""
    free = [i for i in range(table.shape[1]) if i != time]
    found = []
    for i in range(0, len(free) - 2, 3):
        size = float(np.median(np.sqrt((table[:, free[i : i + 3]] ** 2).sum(axis=1))))
        if free[i + 2] == free[i] + 2 and any(abs(size / gravity - 1) < 0.05 for gravity in (G0, 1.0)):
            found.append(free[i])
    return found[0] if len(found) == 1 else None


def _time_place(table: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> int | None:
    """Return the first column that only goes on."""
    if table.shape[0] < 2:
        return None
    steps = np.diff(table, axis=0)
    onward = (steps >= 0).all(axis=0) & (steps > 0).any(axis=0)
    return int(np.flatnonzero(onward)[0]) if onward.any() else None


def _inertial_tags(lines: Sequence[str], delimiter: str) -> list[str]:
    """Return the texts of cells that name an inertial sensor, the most frequent first."""
    tags: Counter[str] = Counter()
    for line in lines:
        for cell in split_line(line, delimiter)[:3]:
            if _INERTIAL.fullmatch(cell.strip("\"'")):
                tags[cell.strip("\"'")] += 1
    return [tag for tag, _ in tags.most_common()]

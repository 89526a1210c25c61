"""Bare columns x, y, z: which sensor they are, by a column of tags or by the name of the file."""

import re
from collections.abc import Sequence
from dataclasses import replace

from imucal.readers.tables.columns import Triad, ask, columns_text
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.names import Column
from imucal.readers.tables.timing import Cells
from imucal.recording import Sensor

#: Text of a row's tag for the gyroscope -> for the accelerometer.
_PARTNERS = {
    "gyro": "accel",
    "Gyro": "Accel",
    "GYRO": "ACCEL",
    "gyroscope": "accelerometer",
    "Gyroscope": "Accelerometer",
    "GYROSCOPE": "ACCELEROMETER",
    "gyr": "acc",
    "Gyr": "Acc",
    "GYR": "ACC",
}


def of_vector(
    path: str, columns: Sequence[Column], cells: Cells, axes: tuple[Column, ...], name: str
) -> tuple[Triad | None, Triad | None, str]:
    """Return the sensors of bare columns x, y, z: by a column of tags, or by the name of the file."""
    places = (axes[0].place, axes[1].place, axes[2].place)
    headers = (axes[0].header, axes[1].header, axes[2].header)
    base = Triad(sensor=Sensor.GYROSCOPE, places=places, headers=headers)
    for column in columns:
        tags = {cell.strip("\"'") for cell in cells(column.place) if cell and not is_number(cell)}
        gyro_tag = next((tag for tag in sorted(tags) if tag.lower().startswith("gyr")), None)
        accel_tag = next((tag for tag in sorted(tags) if tag.lower().startswith("acc")), None)
        if gyro_tag is None and accel_tag is None:
            continue
        gyro_tag = gyro_tag or {b: a for a, b in _PARTNERS.items()}.get(accel_tag or "")
        accel_tag = accel_tag or _PARTNERS.get(gyro_tag or "")
        gyro = replace(base, rows=(column.place, gyro_tag)) if gyro_tag else None
        accel = (
            replace(base, sensor=Sensor.ACCELEROMETER, rows=(column.place, accel_tag)) if accel_tag else None
        )
        return gyro, accel, f"by the tags of column {column.header or column.place}"
    named = sensor_of_name(name)
    if named is None:
        problem = f"x, y and z are there ({', '.join(headers)}), but not of which sensor"
        text = columns_text("0", base, None)
        raise ask(
            path,
            problem,
            [column.header for column in columns],
            example=f"{text} or {text.replace('g=', 'a=')}",
        )
    triad = replace(base, sensor=named)
    return (
        (triad, None, "by the name of the file")
        if named is Sensor.GYROSCOPE
        else (None, triad, "by the name of the file")
    )


def sensor_of_name(name: str) -> Sensor | None:
    """Return the sensor that the name of a file names, if it names one."""
    plain = name.lower()
    gyro = re.search(r"gyr|angular|rotation_?rate", plain) is not None
    accel = re.search(r"acc(?!u)", plain) is not None
    if gyro == accel:
        return None
    return Sensor.GYROSCOPE if gyro else Sensor.ACCELEROMETER

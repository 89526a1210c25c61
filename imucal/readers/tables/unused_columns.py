"""Columns that were not read: a sensor that was not found may be among them, and that is said."""

from collections.abc import Sequence

from imucal.findings import Finding
from imucal.readers.tables.columns import NamedTable, Triad, columns_text, triad_of
from imucal.readers.tables.line_splits import is_number
from imucal.readers.tables.names import NamedColumn, Role, is_of_something_else
from imucal.recording import AXES, Axis, Sensor

#: Columns that are listed.
_MOST = 12


def missing_sensor(table: NamedTable, gyro: Triad | None, accel: Triad | None) -> tuple[Finding, ...]:
    """Return a finding where a sensor, or an axis, was not found and columns of numbers were left over.

    Columns x, y, z, or some of them, that are left over may be the sensor: that is a warning, which says
    what names them. Others are listed in a remark.
    """
    found = {Sensor.GYROSCOPE: gyro, Sensor.ACCELEROMETER: accel}
    used = {index for triad in found.values() if triad is not None for index in triad.indices}
    left = [column for column in table.columns if column.index not in used and _may_be_samples(table, column)]
    if not left:
        return ()
    listed = f"columns that were not read: {_listed(left)}."
    findings = []
    for sensor, triad in found.items():
        if triad is not None and triad.axes != AXES:
            text = f"Only {' and '.join(triad.axes)} of the {sensor} was found in the table; {listed}"
            findings.append(Finding(level="info", code="axis-missing", axis=sensor.short, text=text))
        if triad is None:
            findings.append(_not_found(table, sensor, _candidate(left, sensor), found, listed))
    return tuple(findings)


def _not_found(
    table: NamedTable, sensor: Sensor, candidate: Triad | None, found: dict[Sensor, Triad | None], listed: str
) -> Finding:
    text = f"No {sensor} was found in the table; {listed}"
    if candidate is None:
        return Finding(level="info", code="sensor-missing", axis=sensor.short, text=text)
    both = found | {sensor: candidate}
    ready = columns_text(table.time, both[Sensor.GYROSCOPE], both[Sensor.ACCELEROMETER])
    advice = f"If it is among them, give a columns text such as {ready}."
    return Finding(level="warning", code="sensor-missing", axis=sensor.short, text=text, advice=advice)


def _listed(columns: Sequence[NamedColumn]) -> str:
    """Return some columns with their indices, for a message."""
    shown = ", ".join(f"{column.index} {column.header.strip() or '(no name)'}" for column in columns[:_MOST])
    return shown + (f", … {len(columns) - _MOST} more" if len(columns) > _MOST else "")


def _may_be_samples(table: NamedTable, column: NamedColumn) -> bool:
    if column.role in {Role.TIME, Role.COUNTER, Role.TEMPERATURE} or is_of_something_else(column):
        return False
    filled = [cell.strip("\"'") for cell in table.cells(column.index) if cell]
    return bool(filled) and all(map(is_number, filled))


def _candidate(columns: Sequence[NamedColumn], sensor: Sensor) -> Triad | None:
    """Return the columns x, y, z that a sensor may be in: those named as its own before others."""
    families: dict[tuple[str, ...], dict[Axis, NamedColumn]] = {}
    for column in columns:
        if column.axis in {0, 1, 2} and column.role in {Role(str(sensor)), Role.VECTOR, Role.OTHER}:
            families.setdefault(column.family, {}).setdefault(AXES[column.axis], column)
    own = [axes for family, axes in families.items() if family[0] == sensor]
    whole = [axes for axes in families.values() if len(axes) == len(AXES)]
    axes = next(iter(own or whole), None)
    if axes is None:
        return None
    names = tuple(axis for axis in AXES if axis in axes)
    return triad_of(sensor, [axes[name] for name in names], axes=names)

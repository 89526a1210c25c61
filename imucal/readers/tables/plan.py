"""Choose the columns to read from a table by name: sensors, times and temperature, with the reasons."""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import PurePath
from typing import TypeAlias

import numpy as np

from imucal.errors import ChoiceError, Fix
from imucal.findings import Finding
from imucal.readers import fixes
from imucal.readers.files import refused
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import UnitGuess, gravity_length
from imucal.readers.tables.columns import ColumnsError, NamedTable, Triad, parse_columns_text
from imucal.readers.tables.dialects import Dialect
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.names import (
    NamedColumn,
    Role,
    is_of_something_else,
    listed,
    parse_column,
    plain_name,
    sensor_of_name,
)
from imucal.readers.tables.stamps import TimeChoice, choose_times, named_time, time_of_columns, why_no_time
from imucal.recording import AXES, Sensor

Found: TypeAlias = dict[Sensor, Triad]

_CLOCKS = ("header", "log")

_BY_NAME = "by name"

#: Columns with the device or sensor of each row.
_INSTANCE = listed(
    "i instance imu imu_id sensor sensor_id sensorid device device_id dev source src id unit_id topic frame "
    "frame_id child_frame_id name tag type stream channel"
)

#: Tag of gyroscope rows -> tag of accelerometer rows.
_PARTNERS = {
    case(gyro): case(accel)
    for gyro, accel in (("gyro", "accel"), ("gyroscope", "accelerometer"), ("gyr", "acc"))
    for case in (str.lower, str.capitalize, str.upper)
}

#: Most columns that a message lists.
_MAX_LISTED = 12
#: Most values of --columns that a message suggests.
_MAX_EXAMPLES = 4
#: Most different tags in a column.
_MAX_TAGS = 8


@dataclass(frozen=True, kw_only=True)
class SensorPlan:
    """The columns of one sensor.

    `stated` is the unit in the header or the dialect; `untimed` is why it has no time.
    """

    triad: Triad
    time: TimeChoice | None
    log_time: TimeChoice | None = None
    stated: UnitGuess | None = None
    untimed: str = ""


@dataclass(frozen=True, kw_only=True)
class TablePlan:
    """The columns to read from a table, gyroscope first, and the reasons; `temperature` is an index."""

    sensors: tuple[SensorPlan, ...]
    temperature: int | None
    dialect: Dialect | None
    decisions: tuple[tuple[str, str], ...]
    findings: tuple[Finding, ...] = ()

    @property
    def layout(self) -> str:
        """The name of the dialect; empty if there is none."""
        return self.dialect.name if self.dialect else ""

    @property
    def topics(self) -> tuple[str, ...]:
        return tuple(header for sensor in self.sensors for header in sensor.triad.headers)


def make_plan(table: NamedTable, options: ReadOptions, *, name: str = "", shape: str = "") -> TablePlan:
    """Choose the columns of a table from their names and first cells.

    The `name` of the file may contain the sensor; `shape` describes the columns in messages. Raises
    ChoiceError if the choice is ambiguous.
    """
    name = name or PurePath(table.path).name
    if options.columns is None:
        return _by_name(table, options, name, shape)
    try:
        sensors, indices, temperature = parse_columns_text(options.columns, table)
        time = time_of_columns(table, indices) if indices else None
    except ColumnsError as error:
        with suppress(ChoiceError):
            named = _by_name(table, options, name, shape)
            text = table.columns_text(*(sensor.triad for sensor in named.sensors))
            error = table.ask(error.wrong, example=text)
        raise error from None
    return _plan(table, sensors, temperature, "as given", options, time=time)


def _by_name(table: NamedTable, options: ReadOptions, name: str, shape: str) -> TablePlan:
    given = [s for s in Sensor if options.unit_of(s) is not None or options.scale_of(s) is not None]
    triads, reason = find_triads(table, units_given=given), _BY_NAME
    found = _each(partial(_pick, table, triads))
    if not triads:
        found, reason = find_bare_triads(table, name)
    if not found:
        # Next to a complete gyroscope, az may be an azimuth.
        found, reason = _each(partial(_single_axes, table)), _BY_NAME
    if not found:
        raise _nothing_found(table, shape)
    if reason == _BY_NAME:
        found, rows = _rows_of_sensors(table, found)
        reason += f", {rows}" if rows else ""
    near = [index for triad in found.values() for index in triad.indices]
    plan = _plan(table, list(found.values()), find_temperature(table.columns, near=near), reason, options)
    return replace(plan, findings=_missing(table, found))


def _plan(
    table: NamedTable,
    triads: Sequence[Triad],
    temperature: int | None,
    reason: str,
    options: ReadOptions,
    *,
    time: TimeChoice | None = None,
) -> TablePlan:
    decisions, sensors = [], []
    for triad in triads:
        names = ", ".join(column.header or f"column {column.index}" for column in triad.columns)
        decisions.append((f"{triad.sensor} columns", f"{names}, {reason}"))
        plan = SensorPlan(triad=triad, time=time) if time else _with_time(table, triad, options)
        sensors.append(replace(plan, stated=_stated_unit(table, triad)))
    if table.dialect is not None:
        decisions.append(("layout", f"{table.dialect.name}, from the column names"))
    return TablePlan(
        sensors=tuple(sensors), temperature=temperature, dialect=table.dialect, decisions=tuple(decisions)
    )


def _stated_unit(table: NamedTable, triad: Triad) -> UnitGuess | None:
    """Return the unit in the header or of the dialect, which may be unknown; None without one."""
    unknown = next((column for column in triad.columns if column.unknown_unit), None)
    if triad.unit is not None:
        return UnitGuess("from the column header", triad.unit)
    if unknown is not None:
        return UnitGuess(f"column {unknown.header!r}", unknown=unknown.unknown_unit or "")
    dialect = table.dialect
    unit = dialect.unit_of(triad.sensor) if dialect is not None else None
    if dialect is None or unit is None:
        return None
    how = dialect.unit_source or f"as in logs of {dialect.name}"
    return UnitGuess(how, unit, assumed=dialect.may_be_g)


def _each(find: Callable[[Sensor], Triad | None]) -> Found:
    return {sensor: triad for sensor in Sensor if (triad := find(sensor)) is not None}


def _with_time(table: NamedTable, triad: Triad, options: ReadOptions) -> SensorPlan:
    if options.time is not None and options.time not in _CLOCKS:
        return SensorPlan(triad=triad, time=named_time(table, options.time))
    times = choose_times(table, triad.sensor)
    stamps = [time for time in times if time.kind != "counter"]
    if options.time == "log":
        return SensorPlan(triad=triad, time=_log_time(table, times, stamps))
    if table.dialect is not None and table.dialect.has_log_time and len(stamps) > 1:
        # Constant stamps are reported by the clock, which then uses log time.
        header = next((time for time in stamps if "stamp" in time.name.lower()), stamps[0])
        log = next(time for time in stamps if time is not header)
        return SensorPlan(triad=triad, time=header, log_time=log)
    return SensorPlan(triad=triad, time=next(iter(times), None), untimed="" if stamps else why_no_time(table))


def _log_time(table: NamedTable, times: Sequence[TimeChoice], stamps: Sequence[TimeChoice]) -> TimeChoice:
    if len(stamps) < 2:
        found = f"found times: {', '.join(time.name for time in times) or 'none'}"
        text = f"there is no log time besides the time stamps; {found}"
        raise refused(table.path, text, ChoiceError, Fix("name the column to take as time", "time", "CLOCK"))
    return stamps[1]


def _nothing_found(table: NamedTable, shape: str) -> ColumnsError:
    single = [f"{c.header} ({c.role})" for c in table.columns if c.sensor]
    if not any(column.header for column in table.columns):
        problem = f"the {len(table.columns)} columns have no names"
    elif single:
        problem = f"expected x, y and z of one sensor, found only {', '.join(single)}"
    else:
        problem = "no column has the name of a gyroscope or accelerometer axis"
    return table.ask(f"{shape}: {problem}" if shape else problem)


def _families(table: NamedTable, *roles: Role) -> Iterator[dict[int, NamedColumn]]:
    """Yield sets of columns by axis; raises ChoiceError for equal axes."""
    families: dict[tuple[str, ...], list[NamedColumn]] = {}
    for column in table.columns:
        if column.axis is not None and column.role in roles:
            families.setdefault((str(column.role), *column.words), []).append(column)
    for members in families.values():
        numbers = sorted(column.axis or 0 for column in members)
        first = 1 if numbers == [1, 2, 3] and all(column.numbered for column in members) else 0
        axes: dict[int, NamedColumn] = {}
        for column in members:
            other = axes.setdefault((column.axis or 0) - first, column)
            if other is not column:
                names = dict.fromkeys((other.header, column.header))
                both = " and ".join(repr(name) for name in names)
                raise table.ask(f"columns {other.index} and {column.index} have the same name, {both}")
        yield axes


def _whole(table: NamedTable, *roles: Role) -> Iterator[dict[int, NamedColumn]]:
    """Yield sets of exactly x, y, z; skip matrices and quaternions."""
    names = {plain_name(column.header) for column in table.columns}

    def has_w(column: NamedColumn) -> bool:
        before, x, after = plain_name(column.header).rpartition("x")
        return bool(x) and f"{before}w{after}" in names

    return (axes for axes in _families(table, *roles) if axes.keys() == {0, 1, 2} and not has_w(axes[0]))


def find_triads(table: NamedTable, *, units_given: Sequence[Sensor] = ()) -> list[Triad]:
    """Return every complete triad, preferred ones first, except bare x, y, z.

    Raises ChoiceError for duplicate names, and for different units unless the caller gave the unit.
    """
    triads = [Triad.of(Sensor(str(axes[0].role)), axes) for axes in _whole(table, *map(Role, Sensor))]
    for triad in triads:
        # A unit in one name applies to all axes: wx(rad/s), wy, wz.
        if triad.sensor not in units_given and len({*triad.units} - {None}) > 1:
            named = zip(triad.headers, triad.units, strict=True)
            axes = ", ".join(f"{header} in {unit or 'no unit'}" for header, unit in named)
            text = (
                f"the axes of the {triad.sensor} have different units ({axes}); expected one unit; found "
                f"columns: {table.listed}"
            )
            give = fixes.unit(triad.sensor, f"give the unit of the {triad.sensor}")
            raise refused(table.path, text, ChoiceError, give, Fix("correct the header"))

    def is_linear(triad: Triad) -> bool:
        # Phones provide linear acceleration without gravity.
        name = triad.headers[0].lower().lstrip("\"'").rpartition(".")[2]
        return triad.sensor is Sensor.ACCELEROMETER and name.startswith("lin")

    measured = {triad.sensor for triad in triads if not is_linear(triad)}
    kept = [triad for triad in triads if not is_linear(triad) or triad.sensor not in measured]
    kept = _without_gravity_vectors(kept)
    return sorted(kept, key=lambda triad: triad.sensor is Sensor.ACCELEROMETER)


def _without_gravity_vectors(triads: Sequence[Triad]) -> list[Triad]:
    """Return triads without gx, gy, gz if they are the direction of gravity and rx, ry, rz the rotation rate.

    If gx, gy, gz are not of constant length, they are the gyroscope, and rx, ry, rz are left out.
    """
    rates = [triad for triad in triads if triad.columns[0].words[:1] == ("r",)]
    others = [triad for triad in triads if triad.sensor is Sensor.GYROSCOPE and triad not in rates]
    if not rates or not others:
        return list(triads)
    gravity = [triad for triad in others if _is_gravity_vector(triad)]
    left_out = gravity if len(gravity) == len(others) else rates
    return [triad for triad in triads if triad not in left_out]


def _is_gravity_vector(triad: Triad) -> bool:
    columns = [[cell for cell in column.filled if is_number(cell)] for column in triad.columns]
    if len({len(cells) for cells in columns}) > 1:
        return False
    return gravity_length(np.array(columns, dtype=np.float64).T) is not None


def _single_axes(table: NamedTable, sensor: Sensor) -> Triad | None:
    """Return the axes of a sensor without a complete triad; None if they are ambiguous."""
    sets = list(_families(table, Role(str(sensor))))
    if len(sets) != 1 or any(column.numbered for column in sets[0].values()):
        return None
    triad = Triad.of(sensor, sets[0])
    return triad if len({*triad.units} - {None}) <= 1 else None


def _pick(table: NamedTable, triads: Sequence[Triad], sensor: Sensor) -> Triad | None:
    found = [triad for triad in triads if triad.sensor is sensor]
    if len(found) <= 1:
        return next(iter(found), None)
    texts = [table.columns_text(*pair) for pair in _pairs(triads)]
    problem = f"{len(found)} sets of {sensor} columns: " + ", ".join(triad.headers[0] for triad in found)
    raise table.ask(problem, example=" or ".join(texts))


def _pairs(triads: Sequence[Triad]) -> Sequence[tuple[Triad, ...]]:
    """Return pairs of gyroscope and accelerometer, matched by common words, then by position."""
    gyros = [triad for triad in triads if triad.sensor is Sensor.GYROSCOPE]
    accels = [triad for triad in triads if triad.sensor is Sensor.ACCELEROMETER]

    def likeness(pair: tuple[Triad, ...]) -> tuple[int, int]:
        gyro, accel = (triad.columns[0] for triad in pair)
        first, second = {*gyro.words}, {*accel.words}
        return len(first & second) - len(first ^ second), -abs(gyro.index - accel.index)

    if not gyros or not accels:
        return [(triad,) for triad in triads][:_MAX_EXAMPLES]
    pairs = [max(((gyro, accel) for accel in accels), key=likeness) for gyro in gyros]
    if len(gyros) < len(accels):
        pairs = [max(((gyro, accel) for gyro in gyros), key=likeness) for accel in accels]
    return pairs[:_MAX_EXAMPLES]


def find_temperature(columns: Sequence[NamedColumn], *, near: Sequence[int] = ()) -> int | None:
    """Return the temperature column nearest to the sensors' columns."""
    indices = [column.index for column in columns if column.role is Role.TEMPERATURE]
    return min(indices, key=lambda index: min((abs(index - n) for n in near), default=0), default=None)


#: Largest number of sensors that a column may number.
_MAX_SENSORS = 8


def find_bare_triads(table: NamedTable, name: str) -> tuple[Found, str]:
    """Return the sensors of bare columns x, y, z, and the reason; empty without such columns.

    Raises ChoiceError if the sensor is unknown.
    """
    axes = next(_whole(table, Role.VECTOR), None)
    if axes is None:
        return {}, ""
    both = {sensor: Triad.of(sensor, axes) for sensor in Sensor}
    for column in table.columns:
        tags = _tags({cell for cell in column.filled if not is_number(cell)})
        several = max(map(len, tags.values()))
        if several > 1:
            raise _several_rows(table, both, tags)
        if several:
            tagged = {
                s: replace(both[s], rows=(column.index, names[0])) for s, names in tags.items() if names
            }
            return tagged, f"by the tags of column {column.header or column.index}"
    sensor = sensor_of_name(name)
    if sensor is None:
        gyro, accel = both.values()
        problem = f"x, y and z ({', '.join(gyro.headers)}) have no sensor in their names"
        example = f"{table.columns_text(gyro)} or {table.columns_text(accel)}"
        if (found := _column_of_ids(table, gyro)) is not None:
            column, first, second = found
            problem += f"; column {column.header or column.index} may number the sensors"
            rows = [triad.text(f"@{column.index}:{row}") for triad, row in ((gyro, first), (accel, second))]
            example = ",".join(filter(None, [table.columns_text(), *rows]))
        raise table.ask(problem, example=example)
    return {sensor: both[sensor]}, "by the name of the file"


def _column_of_ids(table: NamedTable, triad: Triad) -> tuple[NamedColumn, str, str] | None:
    """Return a column that may number the sensors, and two of its numbers, which change often."""
    for column in table.columns:
        cells, values = column.filled, [*dict.fromkeys(column.filled)]
        changes = sum(a != b for a, b in pairwise(cells))
        few = 2 <= len(values) <= _MAX_SENSORS and 4 * changes > len(cells)
        if few and column.index not in triad.indices and all(map(str.isdigit, values)):
            return column, values[0], values[1]
    return None


def _several_rows(
    table: NamedTable, triads: dict[Sensor, Triad], tags: dict[Sensor, list[str]]
) -> ColumnsError:
    texts = []
    for k in range(max(map(len, tags.values()))):
        rows = {sensor: names[min(k, len(names) - 1)] for sensor, names in tags.items() if names}
        parts = [triads[sensor].text(f"@{tag}") for sensor, tag in rows.items()]
        texts.append(",".join(filter(None, [table.columns_text(), *parts])))
    problem = f"rows of several sensors: {', '.join(tag for names in tags.values() for tag in names)}"
    return table.ask(problem, example=" or ".join(texts))


def _tags(texts: set[str]) -> dict[Sensor, list[str]]:
    """Return the tags of each sensor's rows; one tag of a usual pair implies the other."""
    gyros, accels = (sorted(t for t in texts if t.lower().startswith(start)) for start in ("gyr", "acc"))
    if not gyros:
        gyros = [name for name, other in _PARTNERS.items() if accels == [other]]
    if not accels and len(gyros) == 1 and gyros[0] in _PARTNERS:
        accels = [_PARTNERS[gyros[0]]]
    return {Sensor.GYROSCOPE: gyros, Sensor.ACCELEROMETER: accels}


def _rows_of_sensors(table: NamedTable, found: Found) -> tuple[Found, str]:
    """Restrict columns to the rows of their sensor if a text column contains it; return the reason, too.

    Raises ChoiceError if rows of several sensors can't be separated.
    """
    for column in table.columns:
        texts = [] if column.role is Role.TIME else sorted({*column.filled})
        tags = {sensor: [text for text in texts if sensor_of_name(text) is sensor] for sensor in Sensor}
        if len(texts) <= _MAX_TAGS and any(tags.values()) and not any(map(is_number, texts)):
            how = f"in the rows that column {column.header or column.index} names"
            return _each(partial(_in_rows, table, found, column=column, tags=tags)), how
    _refuse_instances(table, found)
    return found, ""


def _in_rows(
    table: NamedTable, found: Found, sensor: Sensor, *, column: NamedColumn, tags: dict[Sensor, list[str]]
) -> Triad | None:
    names, triad = tags[sensor], found.get(sensor)
    if triad is None and names:
        # The header is about the other sensor, so its unit does not apply.
        (other,) = found.values()
        columns = tuple(parse_column(f"column {at}", at) for at in other.indices)
        triad = Triad(sensor=sensor, columns=columns)
    if triad is None or len(names) == 1:
        return triad and replace(triad, rows=(column.index, names[0]))
    texts = sorted({*column.filled})
    rows = names or [text for text in texts if not any(text in named for named in tags.values())] or texts
    examples = [table.columns_text(triad, rows=f"@{column.index}:{row}") for row in rows[:_MAX_EXAMPLES]]
    which = f"{len(names)} tags name" if names else "no tag names"
    found_tags = f"column {column.header or column.index} has tags of rows ({', '.join(texts)})"
    raise table.ask(f"{found_tags}; {which} the {sensor}", example=" or ".join(examples))


def _refuse_instances(table: NamedTable, found: Found) -> None:
    """Raise ChoiceError for rows of several sensors, as in ArduPilot's IMU message."""
    samples = next(iter(found.values())).columns[0].cells
    # Compare the last part: frame_id of header.frame_id.
    columns = [c for c in table.columns if plain_name(c.header).rpartition(".")[2] in _INSTANCE]
    for column in columns:
        pairs = zip(column.cells, samples, strict=False)
        devices = sorted({cell.strip("\"'") for cell, sample in pairs if cell and sample})
        if all(map(str.isdigit, devices)):
            devices.sort(key=int)
        elif any(map(is_number, devices)):
            continue
        if not 1 < len(devices) <= _MAX_TAGS:
            continue
        name = column.header.strip("\"'")
        at = name if re.fullmatch(r"\w+", name) else str(column.index)
        texts = [
            table.columns_text(*found.values(), rows=f"@{at}:{cell}") for cell in devices[:_MAX_EXAMPLES]
        ]
        problem = f"rows of {len(devices)} sensors, numbered by column {name} ({', '.join(devices)})"
        raise table.ask(problem, example=" or ".join(texts))


def _missing(table: NamedTable, found: Found) -> tuple[Finding, ...]:
    """Return findings for missing sensors or axes if numeric columns are unused; warnings for x, y, z."""
    used = {index for triad in found.values() for index in triad.indices}
    left = [column for column in table.columns if column.index not in used and _may_be_samples(column)]
    if not left:
        return ()
    entries = [f"{column.index} {column.header or '(no name)'}" for column in left[:_MAX_LISTED]]
    entries += [f"… {len(left) - _MAX_LISTED} more"] if len(left) > _MAX_LISTED else []
    listed = f"unused columns: {', '.join(entries)}."
    findings = []
    for sensor in Sensor:
        triad = found.get(sensor)
        if triad is None:
            text = f"No {sensor} was found in the table; {listed}"
            missing = Finding("info", "sensor-missing", text, axis=sensor.short)
            if guessed := _only_axes(table, left, sensor):
                ready = table.columns_text(*_each((found | {sensor: guessed}).get).values())
                advice = f"If it is one of them, give a columns text such as {ready}."
                give = Fix("", "columns", ready)
                missing = replace(missing, level="warning", advice=advice, fix=give)
            findings.append(missing)
        elif triad.axes != AXES:
            text = f"Only {' and '.join(triad.axes)} of the {sensor} was found in the table; {listed}"
            findings.append(Finding("info", "axis-missing", text, axis=sensor.short))
    return tuple(findings)


def _only_axes(table: NamedTable, left: Sequence[NamedColumn], sensor: Sensor) -> Triad | None:
    rest = replace(table, columns=tuple(left))
    with suppress(ChoiceError):
        sets = _families(rest, Role.VECTOR, Role.OTHER, Role(str(sensor)))
        whole = [axes for axes in sets if axes.keys() == {0, 1, 2}]
        return Triad.of(sensor, whole[0]) if len(whole) == 1 else _single_axes(rest, sensor)
    return None


def _may_be_samples(column: NamedColumn) -> bool:
    counts = column.role is Role.COUNTER and column.counts
    if counts or column.role in {Role.TIME, Role.TEMPERATURE} or is_of_something_else(column):
        return False
    return column.is_numeric

"""Which columns of a table are the sensors and the time: chosen by name, or as the user said."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

from imucal.errors import ChoiceError
from imucal.readers.tables.names import Column, Role
from imucal.recording import Sensor
from imucal.units import parse_sample_unit

#: Rows of a sensor: the place of a column and the text its cells must hold; None for all rows.
Rows: TypeAlias = tuple[int, str] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Triad:
    """The x, y and z columns of one sensor.

    Attributes
    ----------
    sensor
        What they measure.
    places
        Of the columns x, y, z.
    headers
        Their names.
    unit
        Their unit, a key of `imucal.units.SAMPLE_UNITS`; None where the names don't say.
    rows
        The rows that belong to it.
    """

    sensor: Sensor
    places: tuple[int, int, int]
    headers: tuple[str, str, str]
    unit: str | None = None
    rows: Rows = None

    @property
    def text(self) -> str:
        """The columns as a user gives them: ``1:4``, or ``4+3+2`` where they don't follow each other."""
        first = self.places[0]
        if self.places == (first, first + 1, first + 2):
            return f"{first}:{first + 3}"
        return "+".join(str(place) for place in self.places)


def list_columns(headers: Sequence[str], *, most: int = 60) -> str:
    """Return the columns of a table with their places, for a message."""
    shown = [f"{place} {header.strip() or '(no name)'}" for place, header in enumerate(headers[:most])]
    more = f", … {len(headers) - most} more" if len(headers) > most else ""
    return ", ".join(shown) + more


def ask(path: str, problem: str, headers: Sequence[str], *, example: str = "t=0,g=1:4,a=4:7") -> ChoiceError:
    """Return the error that shows the columns and a ready text for them."""
    msg = (
        f"{path}: {problem}; found columns: {list_columns(headers)}; "
        f"say which are which by a columns text such as {example} "
        "(places from 0 with the end left out, or three names joined by +)"
    )
    return ChoiceError(msg)


def find_triads(columns: Sequence[Column], path: str, *, units_given: Sequence[Sensor] = ()) -> list[Triad]:
    """Return every complete x, y, z of a sensor, in the order of the table; second choices last.

    A vector without a sensor (bare x, y, z) is not among them.

    Raises
    ------
    ChoiceError
        If the columns of one triad carry different units and the caller gave none, or two columns
        have the same name.
    """
    families: dict[tuple[str, ...], list[Column]] = {}
    for column in columns:
        if column.index is not None and column.role in {Role.GYROSCOPE, Role.ACCELEROMETER}:
            families.setdefault(column.family, []).append(column)
    headers = [column.header for column in columns]
    triads = []
    for members in families.values():
        axes = in_order(members, path, headers)
        if axes is not None:
            sensor = Sensor(str(members[0].role))
            triads.append(_triad(sensor, axes, path, headers, unit_given=sensor in units_given))
    gravity_free = {triad: _is_linear(triad) for triad in triads}
    kept = [
        triad
        for triad in triads
        if not (gravity_free[triad] and any(o.sensor is triad.sensor and not gravity_free[o] for o in triads))
    ]
    return sorted(kept, key=lambda triad: triad.sensor is Sensor.ACCELEROMETER)


def _is_linear(triad: Triad) -> bool:
    """Return whether a name says linear acceleration, which phones give without gravity."""
    return triad.sensor is Sensor.ACCELEROMETER and triad.headers[0].lower().lstrip("\"'").startswith("lin")


def in_order(members: Sequence[Column], path: str, headers: Sequence[str]) -> tuple[Column, ...] | None:
    """Return the columns of a family as x, y, z; None where one is missing.

    Raises
    ------
    ChoiceError
        If two columns claim the same axis.
    """
    indices = sorted(column.index for column in members if column.index is not None)
    first = 1 if indices == [1, 2, 3] and all(column.numbered for column in members) else 0
    places: dict[int, Column] = {}
    for column in members:
        axis = (column.index or 0) - first
        if axis in places:
            problem = f"columns {places[axis].place} and {column.place} are both {column.header.strip()!r}"
            raise ask(path, problem, headers)
        places[axis] = column
    return (places[0], places[1], places[2]) if {0, 1, 2} <= places.keys() else None


def _triad(
    sensor: Sensor, axes: tuple[Column, ...], path: str, headers: Sequence[str], *, unit_given: bool
) -> Triad:
    x, y, z = axes
    units = [_unit_of(sensor, column) for column in axes]
    if len(set(units)) > 1 and not unit_given:
        shown = ", ".join(
            f"{column.header} in {unit or 'no unit'}" for column, unit in zip(axes, units, strict=True)
        )
        problem = (
            f"the axes of the {sensor} carry different units ({shown}), so at least one of them is wrong; "
            f"expected one unit; give the unit of the {sensor}, or correct the header"
        )
        msg = f"{path}: {problem}; found columns: {list_columns(headers)}"
        raise ChoiceError(msg)
    return Triad(
        sensor=sensor,
        places=(x.place, y.place, z.place),
        headers=(x.header, y.header, z.header),
        unit=units[0] if len(set(units)) == 1 else None,
    )


def _unit_of(sensor: Sensor, column: Column) -> str | None:
    parsed = parse_sample_unit(column.unit) if column.unit else None
    return parsed[1] if parsed and parsed[0] is sensor else None


def find_vector(columns: Sequence[Column], path: str) -> tuple[Column, ...] | None:
    """Return the columns x, y, z whose names leave the sensor open, if there is one such triad."""
    members = [column for column in columns if column.role is Role.VECTOR]
    headers = [column.header for column in columns]
    families: dict[tuple[str, ...], list[Column]] = {}
    for column in members:
        families.setdefault(column.family, []).append(column)
    for family in families.values():
        axes = in_order(family, path, headers)
        if axes is not None:
            return axes
    return None


def find_temperature(columns: Sequence[Column], *, near: Sequence[int] = ()) -> int | None:
    """Return the place of the temperature column; of several, the one nearest the sensors' columns."""
    places = [column.place for column in columns if column.role is Role.TEMPERATURE]
    return min(places, key=lambda place: min((abs(place - n) for n in near), default=0), default=None)


def pick(
    triads: Sequence[Triad], sensor: Sensor, path: str, headers: Sequence[str], time: str
) -> Triad | None:
    """Return the only triad of a sensor, or None.

    Raises
    ------
    ChoiceError
        If there are several: which one is for the user to say.
    """
    found = [triad for triad in triads if triad.sensor is sensor]
    if len(found) <= 1:
        return found[0] if found else None
    gyros: list[Triad | None] = [triad for triad in triads if triad.sensor is Sensor.GYROSCOPE]
    accels: list[Triad | None] = [triad for triad in triads if triad.sensor is Sensor.ACCELEROMETER]
    texts = [columns_text(time, gyro, accel) for gyro, accel in product(gyros or [None], accels or [None])]
    problem = f"{len(found)} sets of {sensor} columns: " + ", ".join(triad.headers[0] for triad in found)
    raise ask(path, problem, headers, example=" or ".join(texts[:4]))


def columns_text(time: str, gyro: Triad | None, accel: Triad | None) -> str:
    """Return the ready columns text of a choice."""
    parts = [f"t={time}"] if time else []
    parts += [f"g={gyro.text}"] if gyro else []
    parts += [f"a={accel.text}"] if accel else []
    return ",".join(parts)

"""Which columns of a table are the time of a sensor, and what their counts are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias

from imucal.errors import ChoiceError
from imucal.readers.tables.columns import ask, list_columns
from imucal.readers.tables.columns_text import place_of
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.names import Column, Role
from imucal.readers.tables.signatures import Signature
from imucal.readers.tables.stamps import is_text_stamp
from imucal.recording import Sensor
from imucal.units import TIME_UNITS_NS, parse_time_unit

TimeKind: TypeAlias = Literal["stamp", "pair", "week", "date", "text", "counter"]

#: First cells of a column, by place.
Cells: TypeAlias = Callable[[int], Sequence[str]]

#: Words that say which sensor stamped the sample.
_OWNERS = {
    Sensor.GYROSCOPE: ("gyr", "angular"),
    Sensor.ACCELEROMETER: ("acc",),
}
_OTHER_OWNERS = ("mag", "motion", "baro", "gps", "image", "cam")

_SECONDS = frozenset(("sec", "secs", "second", "seconds", "s"))
_NANOSECONDS = frozenset(("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds", "nanos", "ns"))

#: Words of the columns of a date, in order; nanoseconds need not be there.
_DATE_PARTS = (
    frozenset(("year", "yyyy")),
    frozenset(("month",)),
    frozenset(("day",)),
    frozenset(("hour", "hours")),
    frozenset(("minute", "minutes", "min")),
    frozenset(("second", "seconds", "sec")),
    frozenset(("nano", "nanos", "nanosecond", "nanoseconds", "nsec", "ns")),
)
_DATE_NEEDED = 6

#: Word of a name -> how much it is to be preferred; the largest counts.
_PREFERENCE = {
    "stamp": 75,
    "timestamp": 75,
    "time": 65,
    "chiptime": 65,
    "t": 62,
    "ts": 62,
    "ustime": 62,
    "mstime": 62,
    "uptime": 55,
    "elapsed": 55,
    "tick": 50,
    "ticks": 50,
    "tow": 45,
}
#: Words that make a time a worse choice: it was taken by the computer that logged.
_WORSE = {
    "log": -40,
    "logging": -40,
    "host": -40,
    "receive": -40,
    "received": -40,
    "recv": -40,
    "rosbag": -30,
}
_WORSE |= {"gps": -10, "utc": -5, "startup": -5}
#: Words that make it a better one.
_BETTER = {"header": 15, "hw": 12, "device": 8, "sensor": 8, "fine": 5}


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeChoice:
    """The time of a sensor's samples.

    Attributes
    ----------
    kind
        ``stamp`` one column; ``pair`` seconds and nanoseconds; ``week`` GPS week and time of week;
        ``date`` year, month, day, hour, minute, second and perhaps nanosecond;
        ``text`` dates or times of day; ``counter`` a sample counter.
    places
        Of its columns.
    name
        As the log calls it.
    ns
        ns per count; None where the data must tell.
    ns_source
        Where `ns` comes from, in words.
    """

    kind: TimeKind
    places: tuple[int, ...]
    name: str
    ns: int | None = None
    ns_source: str = ""


def choose_times(
    columns: Sequence[Column], cells: Cells, signature: Signature | None, sensor: Sensor
) -> list[TimeChoice]:
    """Return the times that a table offers for a sensor's samples, best first.

    Stamps come before counters; columns that are empty, or stand still over the first rows, come
    after those that go on.
    """
    found: list[tuple[float, TimeChoice]] = []
    joined = _joins(columns, cells)
    found.extend(joined)
    taken = {place for _, choice in joined for place in choice.places}
    for column in columns:
        if column.role is Role.TIME and column.place not in taken:
            choice = _single(column, cells(column.place), signature)
            if choice is not None:
                found.append((_score(column, cells(column.place), sensor), choice))
    found = [entry for entry in found if entry[0] > 0]
    found.sort(key=lambda entry: -entry[0])
    times = [choice for _, choice in found]
    return times + _counters(columns, cells)


def time_of_place(
    place: int, columns: Sequence[Column], cells: Cells, signature: Signature | None, path: str
) -> TimeChoice:
    """Return the time in a column that the user named.

    Raises
    ------
    ChoiceError
        If its cells are no times.
    """
    column = columns[place]
    choice = _single(column, cells(place), signature)
    if choice is None:
        found = next((cell for cell in cells(place) if cell), "nothing")
        problem = f"column {place} ({column.header}) is no time: it holds {found!r}"
        raise ask(path, problem, [c.header for c in columns])
    if column.role is Role.COUNTER:
        return TimeChoice(kind="counter", places=(place,), name=column.header)
    return choice


def time_of_places(
    places: Sequence[int], columns: Sequence[Column], cells: Cells, signature: Signature | None, path: str
) -> TimeChoice:
    """Return the time in one column, or in two that hold seconds and nanoseconds."""
    if len(places) == 1:
        return time_of_place(places[0], columns, cells, signature, path)
    name = "+".join(columns[place].header or str(place) for place in places)
    return TimeChoice(
        kind="pair", places=(places[0], places[1]), name=name, ns=1, ns_source="seconds + nanoseconds"
    )


def named_time(
    name: str, columns: Sequence[Column], cells: Cells, signature: Signature | None, path: str
) -> TimeChoice:
    """Return the time in the column a user named.

    Raises
    ------
    ChoiceError
        If there is no such column, or it is no time.
    """
    headers = [column.header for column in columns]
    try:
        places = [place_of(part, headers, path, name) for part in name.split("+")]
    except ChoiceError as error:
        msg = f"{path}: there is no time column {name!r}; found columns: {list_columns(headers)}"
        raise ChoiceError(msg) from error
    return time_of_places(places[:2], columns, cells, signature, path)


def _single(column: Column, cells: Sequence[str], signature: Signature | None) -> TimeChoice | None:
    filled = [cell.strip("\"'") for cell in cells if cell]
    if not filled:
        return None
    name = column.header or str(column.place)
    if sum(map(is_number, filled)) < 0.5 * len(filled):
        if sum(map(is_text_stamp, filled)) < 0.5 * len(filled):
            return None
        return TimeChoice(kind="text", places=(column.place,), name=name, ns=1, ns_source="text")
    ns, source = _unit(column, signature)
    return TimeChoice(kind="stamp", places=(column.place,), name=name, ns=ns, ns_source=source)


def _unit(column: Column, signature: Signature | None) -> tuple[int | None, str]:
    plain = column.header.strip("\"'").lstrip("#%").strip().lower()
    if signature is not None:
        for name, ns in signature.time_ns:
            if name == plain:
                return ns, f"as {signature.name} counts it"
    unit = parse_time_unit(column.unit) if column.unit else None
    if unit is None:
        unit = next((u for word in column.words if (u := _word_unit(word))), None)
    if unit is not None:
        return TIME_UNITS_NS[unit], "from the column header"
    return None, ""


def _word_unit(word: str) -> str | None:
    if len(word) > 4 and word.endswith("time"):
        return parse_time_unit(word.removesuffix("time"))
    return parse_time_unit(word) if len(word) > 1 else None


def _score(column: Column, cells: Sequence[str], sensor: Sensor) -> float:
    words = column.words
    score: float = max((_PREFERENCE.get(word.rstrip("0123456789"), 40) for word in words), default=40)
    score += sum(_WORSE.get(word, 0) + _BETTER.get(word, 0) for word in words)
    if any(word.startswith(_OWNERS[sensor]) for word in words):
        score += 30
    elif any(word.startswith((*_OWNERS[Sensor.GYROSCOPE], *_OWNERS[Sensor.ACCELEROMETER])) for word in words):
        return -1.0
    elif any(word.startswith(_OTHER_OWNERS) for word in words):
        score -= 35
    if column.unit:
        score += 2
    filled = [cell for cell in cells if cell]
    if filled and not is_number(filled[0].strip("\"'")):
        score -= 30
    digits = [cell.lstrip("+-") for cell in filled]
    if digits and all(len(cell) >= 18 and cell.isdigit() for cell in digits):
        score += 10
    if len(set(filled)) <= 1 and len(filled) > 1:
        score = min(score, 5.0)
    return score


def _joins(columns: Sequence[Column], cells: Cells) -> list[tuple[float, TimeChoice]]:
    """Return seconds with nanoseconds, and GPS weeks with the time of week."""
    found: list[tuple[float, TimeChoice]] = []
    seconds: dict[tuple[str, ...], Column] = {}
    fractions: dict[tuple[str, ...], Column] = {}
    for column in columns:
        if column.role is not Role.TIME:
            continue
        spelled = {*column.words, (column.unit or "").lower()}
        stem = tuple(word for word in column.words if word not in _SECONDS | _NANOSECONDS)
        values = [cell for cell in cells(column.place) if cell]
        if not values or not all(cell.isdigit() for cell in values):
            continue
        if _NANOSECONDS & spelled and max(int(cell) for cell in values) < 10**9:
            fractions.setdefault(stem, column)
        elif _SECONDS & spelled:
            seconds.setdefault(stem, column)
    for stem, fraction in fractions.items():
        second = seconds.get(stem)
        if second is not None:
            name = f"{second.header}+{fraction.header}"
            places = (second.place, fraction.place)
            choice = TimeChoice(
                kind="pair", places=places, name=name, ns=1, ns_source="seconds + nanoseconds"
            )
            moving = len(set(cells(fraction.place))) > 1
            found.append((92.0 if moving else 4.0, choice))
    return found + _weeks(columns) + _dates(columns, cells)


def _weeks(columns: Sequence[Column]) -> list[tuple[float, TimeChoice]]:
    week = next((c for c in columns if "week" in c.words and c.index is None), None)
    tow = next((c for c in columns if "tow" in c.words and c.role is Role.TIME), None)
    if week is None or tow is None:
        return []
    ns = TIME_UNITS_NS.get(parse_time_unit(tow.unit) or "") if tow.unit else None
    name = f"{week.header}+{tow.header}"
    choice = TimeChoice(
        kind="week",
        places=(week.place, tow.place),
        name=name,
        ns=ns,
        ns_source="from the column header" if ns else "",
    )
    return [(60.0, choice)]


def _dates(columns: Sequence[Column], cells: Cells) -> list[tuple[float, TimeChoice]]:
    """Return the time that columns of year, month, day, hour, minute and second give together."""
    parts: list[Column] = []
    for names in _DATE_PARTS:
        column = next((c for c in columns if names.intersection(c.words) and c not in parts), None)
        if column is None or not all(is_number(cell) for cell in cells(column.place) if cell):
            break
        parts.append(column)
    if len(parts) < _DATE_NEEDED:
        return []
    name = "+".join(part.header for part in parts)
    places = tuple(part.place for part in parts)
    return [(58.0, TimeChoice(kind="date", places=places, name=name, ns=1, ns_source="date and time"))]


def _counters(columns: Sequence[Column], cells: Cells) -> list[TimeChoice]:
    found = []
    for column in columns:
        values = [cell for cell in cells(column.place) if cell]
        if column.role is Role.COUNTER and len(values) > 1 and all(cell.isdigit() for cell in values):
            numbers = [int(cell) for cell in values]
            if sum(b > a for a, b in pairwise(numbers)) > 0.5 * len(numbers):
                found.append(TimeChoice(kind="counter", places=(column.place,), name=column.header))
    return found

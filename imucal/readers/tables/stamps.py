"""Time in a table: choose a sensor's time columns, find their unit and convert them to ns."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import itemgetter
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray, median
from imucal.errors import ChoiceError
from imucal.readers.clocks import estimate_period
from imucal.readers.clocks.period import LIKELY_RATES, RATES
from imucal.readers.files import refused
from imucal.readers.fixes import TIME
from imucal.readers.tables.columns import NamedTable
from imucal.readers.tables.dates import DAY, HALF_DAY, day_first, is_text_stamp, is_time_of_day, text_kind
from imucal.readers.tables.dialects import Dialect
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.names import STEPS, NamedColumn, Role, plain_name
from imucal.recording import Sensor
from imucal.units import TIME_UNITS_NS, time_unit_ns

_SECOND = 10**9

#: Counts examined at up to three places.
_LOOKED_AT = 1 << 20

Numbers: TypeAlias = NDArray[np.int64] | FloatArray


def pair_stamps(coarse: Numbers, fine: Numbers, ns: int | None, *, text: bool = False) -> IntArray:
    """Return ns from whole seconds, or times as `text`, and finer counts of `ns` ns.

    Without a unit the largest count determines it.
    """
    most = float(fine.max()) if fine.size else 0.0
    if ns is None:
        ns = next((unit for unit in (_SECOND, 10**6, 1000) if most * unit < _SECOND), 1)
    if most * ns >= _SECOND:
        return to_ns(fine, ns)
    whole = rolled(np.asarray(coarse, dtype=np.int64), DAY) if text else to_ns(coarse, _SECOND)
    return whole + to_ns(fine, ns)


def text_stamps(columns: Sequence[IntArray]) -> IntArray:
    """Return ns from parsed texts: one column, or dates, times, and AM or PM."""
    if len(columns) == 1:
        return rolled(columns[0], DAY)
    date, time, *half = columns
    if half:
        time = time % HALF_DAY + half[0]
    return date + time


def rolled(stamps_ns: IntArray, period: int) -> IntArray:
    """Return times of day in ns, with a period added at each restart."""
    if not stamps_ns.size or stamps_ns.min() < 0 or stamps_ns.max() >= period:
        return stamps_ns
    return _turned(stamps_ns, _places(stamps_ns, -period, -period // 2 - 1), period)


def unwrapped(counts: IntArray) -> tuple[IntArray, int]:
    """Return counts without wraps at 8, 16, 24 or 32 bits, and the number of wraps."""
    if counts.size < 2 or counts.min() < 0:
        return counts, 0
    highest = int(counts.max())
    usual = 0
    for bits in (8, 16, 24, 32):
        period = 1 << bits
        if highest >= period:
            continue
        if not usual:
            starts = (0, counts.size // 2, counts.size - _LOOKED_AT) if counts.size > 3 * _LOOKED_AT else (0,)
            length = _LOOKED_AT if len(starts) > 1 else counts.size
            steps = np.concatenate([np.diff(counts[start : start + length]) for start in starts])
            usual = int(np.median(steps[steps > 0])) if (steps > 0).any() else 1
        # Samples may be missing at the wrap.
        most = max(100 * usual, period // 64)
        wraps = _places(counts, -period, min(most - period, -1))
        if wraps.size:
            return _turned(counts, wraps, period), int(wraps.size)
    return counts, 0


def _places(values: IntArray, above: int, most: int) -> IntArray:
    """Return the indices of values after a step in the range (above, most]."""
    steps = np.diff(values)
    places: IntArray = np.flatnonzero((steps > above) & (steps <= most)) + 1
    return places


def _turned(values: IntArray, turns: IntArray, period: int) -> IntArray:
    """Return values with a period added from each of the indices `turns` on."""
    if not turns.size:
        return values
    added = np.zeros(values.size, dtype=np.int64)
    added[turns] = period
    turned: IntArray = values + np.cumsum(added)
    return turned


def to_ns(values: Numbers, ns: int) -> IntArray:
    """Return counts of `ns` ns as int64 ns, shape (n,); floats are split to keep their resolution."""
    if values.dtype.kind == "f":
        return _floats_to_ns(values, ns)
    counts = np.asarray(values, dtype=np.int64)
    if counts.size and max(abs(int(counts.min())), abs(int(counts.max()))) > (1 << 62) // ns:
        # The product would not fit into 64 bits.
        counts = counts - counts[0]
    scaled: IntArray = counts if ns == 1 else counts * ns
    return scaled


def _floats_to_ns(values: Numbers, ns: int) -> IntArray:
    floor = np.floor(values)
    limit = float((1 << 62) // ns)
    whole = np.where(np.abs(floor) < limit, floor, 0.0)
    rest = np.round((values - floor) * ns)
    stamps: IntArray = whole.astype(np.int64) * ns + rest.astype(np.int64)
    return stamps


def infer_time_unit(values: Numbers) -> tuple[str | None, tuple[str, ...]]:
    """Return the most plausible unit of an IMU's times (or None), and all units that fit.

    A unit fits if the rate is between 1 Hz and 20 kHz. If several fit, the magnitude of a time since 1970
    decides.
    """
    rates = rates_by_unit(values)
    if not rates:
        return None, ()
    size = float(np.median(values[:100_000]))
    epoch = next((unit for unit, ns in TIME_UNITS_NS.items() if 1e18 <= size * ns < 4e18), None)
    fits = tuple(unit for unit, rate in rates.items() if RATES[0] * 0.98 <= rate <= RATES[1] * 1.02)
    if epoch is not None and (epoch in fits or not fits):
        return epoch, (epoch,)
    return (fits[0] if len(fits) == 1 else None), fits


def rates_by_unit(values: Numbers) -> dict[str, float]:
    """Return the rate in Hz for each unit; empty if times do not increase."""
    step = typical_step(values)
    return {unit: 1e9 / (step * ns) for unit, ns in TIME_UNITS_NS.items()} if step > 0 else {}


def typical_step(values: Numbers) -> float:
    """Return the sampling period in counts; 0 if the first values do not increase."""
    head = values[:20_000]
    since = head - head[:1]
    span = float(np.ptp(since)) if since.size else 0.0
    if not 0 < span < np.inf:
        return 0.0
    # Scale to integers without exceeding a float's digits.
    steps = np.abs(np.diff(since))
    digits = min(15 - np.ceil(np.log10(span)), np.rint(7 - np.log10(median(steps[steps > 0]))))
    scale = 1.0 if values.dtype.kind == "i" else 10.0**digits
    try:
        period = estimate_period(np.round(since * scale).astype(np.int64), unit_is_known=False)
    except ChoiceError:
        return abs(float(since[-1])) / (head.size - 1)
    return period.tau_ns / scale if period is not None else 0.0


TimeKind: TypeAlias = Literal["ns", "stamp", "pair", "text", "counter"]
_KINDS = {"ns": "complete time stamps", "text": "date and time"}

_TEXTS: Any = {"kind": "text", "ns": 1, "source": "text"}

#: Words that name the sensor of a time.
_OWNERS = {Sensor.GYROSCOPE: ("gyr", "angular"), Sensor.ACCELEROMETER: ("acc",)}
_OTHER_OWNERS = ("mag", "motion", "baro", "gps", "image", "cam")

#: Seconds since 1970 or 1980.
_EPOCH = (5e8, 4e9)

#: Columns of hours or minutes, and columns that restart with them.
_DATED = frozenset({"hour", "hours", "minute", "minutes"})
_RESTARTED = frozenset(
    {"minute", "minutes", "min", "second", "seconds", "sec"}
    | {"nano", "nanos", "nanosecond", "nanoseconds", "nsec", "ns"}
)


def _points(text: str) -> dict[str, int]:
    lines = (line.split() for line in text.strip().splitlines())
    return {word: int(points) for points, *words in lines for word in words}


#: Word -> preference; the largest counts.
_PREFERENCE = _points("""
75 stamp timestamp realtime
65 time chiptime
62 t ts ustime mstime
60 sow tow gpst
55 uptime elapsed
50 tick ticks
""")
_UNKNOWN = 40

#: Word -> bonus; times of the logging computer are less accurate.
_BONUS = _points("""
-40 log logging host receive received recv
-30 rosbag
-10 gps
-5 utc startup
15 header
12 hw
8 device sensor
5 fine
3 sample
""")


@dataclass(frozen=True, kw_only=True)
class TimeChoice:
    """The time of a sensor's samples: indices of its columns, and its name in the log.

    A ``pair`` is seconds (or a text) with a finer column. `ns` per count (of the finer column) is None if the
    data determine it. Dates with the year last begin with the day if `by_day`; if the cells do not decide
    (`open_date`), the month is assumed. `either_ns` are the ns per count of two readings that both give the
    rate of an IMU. `unknown_unit` is a unit in the name that imucal does not know.
    """

    kind: TimeKind
    indices: tuple[int, ...]
    name: str
    ns: int | None = None
    ns_source: str = ""
    either_ns: tuple[int, ...] = ()
    unknown_unit: str = ""
    by_day: bool = False
    open_date: bool = False

    @property
    def words(self) -> str:
        words = self.ns_source if self.kind == "pair" else _KINDS.get(self.kind, "stamps")
        return words + (", read as month, day, year" if self.open_date else "")


def choose_times(table: NamedTable, sensor: Sensor) -> list[TimeChoice]:
    """Return the possible times of a sensor's samples, best first; stamps precede counters."""
    columns = _parts_of_dates(table)[1]
    found = _pairs(columns)
    found += [(_score(columns[1], sensor), _joined(*columns, **_TEXTS)) for columns in dates_and_times(table)]
    taken = {index for _, choice in found for index in choice.indices}
    times = [c for c in columns if c.role is Role.TIME and c.index not in taken]
    found += [(_score(c, sensor), choice) for c in times if (choice := _single(table, c))]
    found.sort(key=itemgetter(0), reverse=True)
    choices = [choice for score, choice in found if score > 0]
    for column in table.columns:
        counts = column.counts if column.role is Role.COUNTER else []
        if sum(b > a for a, b in pairwise(counts)) > 0.5 * len(counts):
            choices.append(_joined(column, kind="counter"))
    return choices


def time_of_columns(table: NamedTable, indices: Sequence[int]) -> TimeChoice:
    """Return the time in one column, in a coarse and a finer one, or in a date and a time of day.

    Raises ChoiceError if the columns are not a time.
    """
    columns = [table.columns[index] for index in indices]
    column = columns[0]
    if len(columns) > 1 and text_kind(column.cells) == "date":
        return _joined(*columns, **_TEXTS)
    if len(columns) == 2:
        if "week" in column.words:
            problem = f"{column.header} counts weeks, which imucal does not add to a time"
            raise table.ask(f"{problem}; use column {columns[1].index} ({columns[1].header}) alone")
        return _pair(*columns)
    if steps := _steps([column]):
        raise table.ask(steps)
    choice = _single(table, column)
    if len(columns) > 2 or choice is None:
        held = next(filter(None, column.cells), "nothing")
        problem = f"column {column.index} ({column.header}) is not a time: it contains {held!r}"
        if len(columns) > 2:
            problem = f"columns {', '.join(map(str, indices))} are not a date, a time of day, and AM or PM"
        raise table.ask(problem)
    return _joined(column, kind="counter") if column.role is Role.COUNTER else choice


def why_no_time(table: NamedTable) -> str:
    """Return why times in a table can't be used, and advice, or an empty text."""
    if parts := _parts_of_dates(table)[0]:
        names = ", ".join(column.header for column in parts)
        return f"{names}: parts of a date; write date and time in one column, such as 2026-11-22 10:00:00.01"
    unread = next((column for column in table.columns if column.role is Role.TIME and column.filled), None)
    if unread is not None and _single(table, unread) is None:
        return f"column {unread.header} contains {unread.filled[0]!r}, which is neither a number nor a date"
    return _steps(table.columns)


def _steps(columns: Sequence[NamedColumn]) -> str:
    header = next((column.header for column in columns if column.words in STEPS), "")
    return header and f"{header} contains steps, not times; write their running sum in a column time"


def _parts_of_dates(table: NamedTable) -> tuple[list[NamedColumn], list[NamedColumn]]:
    dated = any(_DATED.intersection(column.words) for column in table.columns)
    parts = [column for column in table.columns if dated and _RESTARTED.intersection(column.words)]
    return parts, [column for column in table.columns if column not in parts]


def named_time(table: NamedTable, name: str) -> TimeChoice:
    """Return the time in the user's columns; raises ChoiceError."""
    try:
        indices = [table.index_of(part) for part in name.split("+")]
    except ValueError as error:
        text = f"there is no time column {name!r}; found columns: {table.listed}"
        raise refused(table.path, text, ChoiceError, TIME) from error
    return time_of_columns(table, indices)


def _joined(*columns: NamedColumn, kind: TimeKind, ns: int | None = None, source: str = "") -> TimeChoice:
    order = day_first(columns[0].cells) if kind in {"text", "pair"} else False
    return TimeChoice(
        kind=kind,
        indices=tuple(column.index for column in columns),
        name="+".join(column.header or str(column.index) for column in columns),
        ns=ns,
        ns_source=source,
        by_day=bool(order),
        open_date=order is None,
    )


def _single(table: NamedTable, column: NamedColumn) -> TimeChoice | None:
    filled = column.filled
    if filled and sum(map(is_number, filled)) >= 0.5 * len(filled):
        if plain_name(column.header) == _SAMPLE_TIME_FINE and not _dialect_ns(column, table.dialect):
            return _sample_time_fine(column)
        ns, source = _unit(column, table.dialect)
        choice = _joined(column, kind="stamp", ns=ns, source=source)
        return choice if ns else replace(choice, unknown_unit=column.unknown_unit or "")
    texts = filled and sum(map(is_text_stamp, filled)) >= 0.5 * len(filled)
    return _joined(column, **_TEXTS) if texts else None


#: Xsens and Movella: microseconds in logs of DOT, 0.1 ms in logs of MTi.
_SAMPLE_TIME_FINE = "sampletimefine"
_SAMPLE_TIME_FINE_NS = (1_000, 100_000)


def _sample_time_fine(column: NamedColumn) -> TimeChoice:
    """Return the time in the reading that gives the rate of an IMU; both readings if both do."""
    counts = column.counts
    steps = [b - a for a, b in pairwise(counts) if b > a]
    step = median(np.array(steps)) if steps else 0.0
    likely = [
        ns for ns in _SAMPLE_TIME_FINE_NS if step and LIKELY_RATES[0] <= 1e9 / (step * ns) <= LIKELY_RATES[1]
    ]
    if len(likely) == 1:
        source = f"the reading of Xsens' SampleTimeFine with {1e9 / (step * likely[0]):.4g} Hz"
        return _joined(column, kind="stamp", ns=likely[0], source=source)
    return replace(_joined(column, kind="stamp"), either_ns=_SAMPLE_TIME_FINE_NS)


def _dialect_ns(column: NamedColumn, dialect: Dialect | None) -> int | None:
    return dict(dialect.time_ns).get(plain_name(column.header)) if dialect is not None else None


def _unit(column: NamedColumn, dialect: Dialect | None = None) -> tuple[int | None, str]:
    if dialect is not None and (ns := _dialect_ns(column, dialect)) is not None:
        return ns, f"as in logs of {dialect.name}"
    if "sow" in column.words:
        return _SECOND, "seconds of the week"
    ns = time_unit_ns(column.unit) if column.unit else None
    # Units in the middle of a name have at least two letters.
    words = (word.removesuffix("time") if len(word) > 4 else word for word in column.words if len(word) > 1)
    ns = ns or _spelled_ns(*words)
    return ns, "from the column header" if ns else ""


def _spelled_ns(*words: str) -> int | None:
    """Return the ns of the first word that is a unit of at most a second."""
    found = (ns for word in words if (ns := time_unit_ns(word)) is not None and ns <= _SECOND)
    return next(found, None)


def _score(column: NamedColumn, sensor: Sensor) -> float:
    words = column.words
    owners = [owner for owner, starts in _OWNERS.items() if any(word.startswith(starts) for word in words)]
    if owners and sensor not in owners:
        return -1.0
    known = (_PREFERENCE.get(word.rstrip("0123456789"), _UNKNOWN) for word in words)
    score: float = max(known, default=_UNKNOWN)
    score += sum(_BONUS.get(word, 0) for word in words) + (2 if column.unit else 0)
    if owners:
        score += 30
    elif any(word.startswith(_OTHER_OWNERS) for word in words):
        score -= 35
    return _with_cells(score, column.filled)


def _with_cells(score: float, filled: Sequence[str]) -> float:
    """Adjust a preference by the cells; a constant time is the last choice."""
    if not filled:
        return score
    # Prefer numbers to dates, and ns since 1970 to other numbers.
    score -= 0 if is_number(filled[0]) else 30
    digits = [cell.lstrip("+-") for cell in filled]
    # Times coarser than the sampling period repeat.
    score -= 20 if 2 * len(set(filled)) < len(filled) else 0
    score += 10 if all(len(cell) >= 18 and cell.isdigit() for cell in digits) else 0
    return min(score, 5) if len(set(filled)) == 1 < len(filled) else score


def _pairs(columns: Sequence[NamedColumn]) -> list[tuple[float, TimeChoice]]:
    """Return pairs of whole seconds and a finer column; their names differ only in the unit."""
    seconds: dict[tuple[str, ...], NamedColumn] = {}
    fractions: dict[tuple[str, ...], NamedColumn] = {}
    for column in (column for column in columns if column.role is Role.TIME):
        counts = column.counts
        stem = tuple(word for word in column.words if time_unit_ns(word) is None)
        ns = _spelled_ns(column.unit or "", *column.words)
        if counts and (ns or _SECOND) * max(*counts, 1) < _SECOND:
            fractions.setdefault(stem, column)
        elif _is_whole(column.filled, counts, ns):
            seconds.setdefault(stem, column)
    if len(seconds) == 1:
        seconds[()] = next(iter(seconds.values()))
    # A constant fraction is the last choice.
    return [
        (92.0 if len(set(fine.cells)) > 1 else 4.0, _pair(seconds[stem], fine))
        for stem, fine in fractions.items()
        if stem in seconds
    ]


def _is_whole(cells: Sequence[str], counts: Sequence[int], ns: int | None) -> bool:
    if counts:
        return ns == _SECOND or _EPOCH[0] < min(counts) <= max(counts) < _EPOCH[1]
    return 2 * len(set(cells)) < len(cells) and all(map(is_text_stamp, cells))


def _pair(coarse: NamedColumn, fine: NamedColumn) -> TimeChoice:
    ns = _spelled_ns(fine.unit or "", *fine.words)
    fine_unit = {1: "nanoseconds", 1000: "microseconds", 10**6: "milliseconds"}.get(ns or 0, "a fraction")
    text = any(map(is_text_stamp, coarse.filled))
    source = f"{'text' if text else 'seconds'} + {fine_unit}"
    return _joined(coarse, fine, kind="pair", ns=ns if ns != _SECOND else None, source=source)


def dates_and_times(table: NamedTable) -> Iterator[list[NamedColumn]]:
    """Yield adjacent columns of dates and times of day, perhaps with AM and PM."""
    for date, time in pairwise(table.columns):
        filled = time.filled
        if text_kind(date.cells) == "date" and filled and all(map(is_time_of_day, filled)):
            after = table.columns[time.index + 1 : time.index + 2]
            yield [date, time, *(column for column in after if text_kind(column.cells) == "half")]

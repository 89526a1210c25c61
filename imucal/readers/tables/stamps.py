"""Time in a table: joins of columns, counters that wrap, units that the steps show -> ns."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.mapped import blocks
from imucal.readers.room import Room, extremes
from imucal.units import TIME_UNITS_NS

_SECOND = 10**9
DAY = 86_400 * _SECOND
WEEK = 7 * DAY

#: Counts looked at for their usual step, at each of three places.
_LOOKED_AT = 1 << 20

#: A column of counts or values.
Numbers: TypeAlias = NDArray[np.int64] | FloatArray

#: Rates at which IMUs are logged, in Hz; they tell the unit of a time without one.
_RATES = (1.0, 20_000.0)


def date_stamps(parts: Sequence[Numbers], room: Room) -> IntArray:
    """Return times as ns since 1970 from year, month, day, hour, minute, second and perhaps nanosecond."""
    return room.made(parts[0].size, np.int64, lambda at: _dates([part[at] for part in parts]), *parts)


def _dates(parts: Sequence[Numbers]) -> IntArray:
    year, month, day, hour, minute = (np.asarray(part, dtype=np.int64) for part in parts[:5])
    months = ((year - 1970) * 12 + month - 1).astype("datetime64[M]")
    days = months.astype("datetime64[D]").astype(np.int64) + day - 1
    whole = ((days * 24 + hour) * 60 + minute) * 60 * _SECOND + _ns_of(parts[5], _SECOND)
    return np.asarray(whole + (_ns_of(parts[6], 1) if len(parts) > 6 else 0), dtype=np.int64)


def pair_stamps(seconds: Numbers, nanoseconds: Numbers, room: Room) -> IntArray:
    """Return times in ns from their whole seconds and the nanoseconds beside them."""
    whole, rest = to_ns(seconds, _SECOND, room), to_ns(nanoseconds, 1, room)
    return room.made(whole.size, np.int64, lambda part: whole[part] + rest[part], whole, rest)


def week_stamps(weeks: Numbers, of_week: Numbers, ns: int, room: Room) -> IntArray:
    """Return times in ns from weeks, and times of the week counted in units of `ns` ns."""
    tow = to_ns(of_week, ns, room)
    whole = to_ns(weeks, WEEK, room)
    # A receiver without a fix leaves the week at zero or at its last value.
    low, high = extremes(whole) if whole.size else (0, 0)
    if low == high:
        return rolled(tow, WEEK, room)
    return room.made(tow.size, np.int64, lambda part: whole[part] + tow[part], whole, tow)


def rolled(stamps_ns: IntArray, period: int, room: Room) -> IntArray:
    """Return times of day or of week in ns with a period added wherever they start again."""
    if not stamps_ns.size:
        return stamps_ns
    low, high = extremes(stamps_ns)
    if low < 0 or high >= period:
        return stamps_ns
    return _turned(stamps_ns, _places(stamps_ns, -period, -period // 2 - 1), period, room)


def unwrapped(counts: IntArray, room: Room) -> tuple[IntArray, int]:
    """Return counts that go on where an unsigned 8, 16 or 32 bit counter starts again, and how often it did.

    A step back is a wrap only where it leads from near the counter's end to near its start: a restart
    of the logger is none.
    """
    if counts.size < 2:
        return counts, 0
    lowest, highest = extremes(counts)
    if lowest < 0:
        return counts, 0
    usual = 0
    for bits in (8, 16, 32):
        period = 1 << bits
        if highest >= period:
            continue
        usual = usual or _usual_step(counts)
        # Some samples may be missing at the very wrap.
        most = max(100 * usual, period // 64)
        wraps = _places(counts, -period, min(most - period, -1))
        if wraps.size:
            return _turned(counts, wraps, period, room), int(wraps.size)
    return counts, 0


def _usual_step(counts: IntArray) -> int:
    """Return the median of the steps forward; of those at the start, in the middle and at the end of many."""
    starts = (0, counts.size // 2, counts.size - _LOOKED_AT) if counts.size > 3 * _LOOKED_AT else (0,)
    length = _LOOKED_AT if len(starts) > 1 else counts.size
    steps = np.concatenate([np.diff(counts[start : start + length]) for start in starts])
    forward = steps[steps > 0]
    return int(np.median(forward)) if forward.size else 1


def _places(values: IntArray, above: int, most: int) -> IntArray:
    """Return the places to which a step leads that is larger than `above` and not larger than `most`."""
    found = []
    for part in blocks(values.size - 1, values):
        steps = np.diff(values[part.start : part.stop + 1])
        if steps.size and steps.min() <= most:
            found.append(np.flatnonzero((steps > above) & (steps <= most)) + part.start + 1)
    return np.concatenate(found) if found else np.zeros(0, dtype=np.int64)


def _turned(values: IntArray, turns: IntArray, period: int, room: Room) -> IntArray:
    """Return values with a period added from each of the places `turns` on."""

    def of(part: slice) -> IntArray:
        before, stop = np.searchsorted(turns, [part.start, part.stop])
        added = np.zeros(part.stop - part.start, dtype=np.int64)
        added[turns[before:stop] - part.start] = period
        if added.size:
            added[0] += before * period
        return np.asarray(values[part] + np.cumsum(added), dtype=np.int64)

    return room.made(values.size, np.int64, of, values)


def to_ns(values: Numbers, ns: int, room: Room) -> IntArray:
    """Return times counted in units of `ns` ns as int64 ns, shape (n,).

    Integers stay exact. Floats are split first, so that nothing is lost beyond their own resolution.
    """
    start = 0
    if values.dtype.kind == "i":
        if values.size and max(abs(int(one)) for one in extremes(values)) > (1 << 62) // ns:
            start = int(values[0])
        if ns == 1 and not start:
            return np.asarray(values, dtype=np.int64)
    return room.made(
        values.size,
        np.int64,
        lambda part: _ns_of(values[part] - start if start else values[part], ns),
        values,
    )


def _ns_of(values: Numbers, ns: int) -> IntArray:
    if values.dtype.kind == "i":
        return np.asarray(values, dtype=np.int64) * ns
    floor = np.floor(values)
    limit = float((1 << 62) // ns)
    whole = np.where(np.abs(floor) < limit, floor, 0.0)
    return whole.astype(np.int64) * ns + np.round((values - floor) * ns).astype(np.int64)


def infer_time_unit(values: Numbers) -> tuple[str | None, tuple[str, ...]]:
    """Return the unit of times that make sense for an IMU, and all units that fit.

    The rate must lie between 1 Hz and 20 kHz. Where several units fit, the size of a time since 1970
    decides; where that does not help, the unit is None.
    """
    rates = rates_by_unit(values)
    if not rates:
        return None, ()
    size = float(np.median(values[:100_000]))
    epoch = next((unit for unit, ns in TIME_UNITS_NS.items() if 1e18 <= size * ns < 4e18), None)
    fits = tuple(unit for unit, rate in rates.items() if _RATES[0] * 0.98 <= rate <= _RATES[1] * 1.02)
    if epoch is not None and (epoch in fits or not fits):
        return epoch, (epoch,)
    return (fits[0] if len(fits) == 1 else None), fits


def rates_by_unit(values: Numbers) -> dict[str, float]:
    """Return the rate in Hz that times have in each unit; nothing where they do not go on."""
    step = typical_step(values)
    return {unit: 1e9 / (step * ns) for unit, ns in TIME_UNITS_NS.items()} if step > 0 else {}


def typical_step(values: Numbers) -> float:
    """Return the usual step between times: the median, or the mean where stamps repeat."""
    head = values[:20_000]
    steps = np.diff(head)
    forward = steps[steps > 0]
    if not forward.size:
        return 0.0
    if forward.size < 0.5 * steps.size:
        return float((head[-1] - head[0]) / steps.size)
    return float(np.median(steps)) if np.median(steps) > 0 else float(np.median(forward))

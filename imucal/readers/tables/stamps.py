"""Time in a table: joins of columns, counters that wrap, units that the steps show -> ns."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.units import TIME_UNITS_NS

_SECOND = 10**9
DAY = 86_400 * _SECOND
WEEK = 7 * DAY

#: A column of counts or values.
Numbers: TypeAlias = NDArray[np.int64] | FloatArray

#: Rates at which IMUs are logged, in Hz; they tell the unit of a time without one.
_RATES = (1.0, 20_000.0)


def date_stamps(parts: Sequence[Numbers]) -> IntArray:
    """Return times as ns since 1970 from year, month, day, hour, minute, second and perhaps nanosecond."""
    year, month, day, hour, minute = (np.asarray(part, dtype=np.int64) for part in parts[:5])
    months = ((year - 1970) * 12 + month - 1).astype("datetime64[M]")
    days = months.astype("datetime64[D]").astype(np.int64) + day - 1
    whole = ((days * 24 + hour) * 60 + minute) * 60 * _SECOND + to_ns(parts[5], _SECOND)
    return np.asarray(whole + (to_ns(parts[6], 1) if len(parts) > 6 else 0), dtype=np.int64)


def rolled(stamps_ns: IntArray, period: int) -> IntArray:
    """Return times of day or of week in ns with a period added wherever they start again."""
    if not stamps_ns.size or stamps_ns.min() < 0 or stamps_ns.max() >= period:
        return stamps_ns
    steps = np.diff(stamps_ns)
    turns = np.concatenate([[0], np.cumsum(steps < -period // 2)])
    return np.asarray(stamps_ns + turns * period, dtype=np.int64)


def unwrapped(counts: IntArray) -> tuple[IntArray, int]:
    """Return counts that go on where an unsigned 8, 16 or 32 bit counter starts again, and how often it did.

    A step back is a wrap only where it leads from near the counter's end to near its start: a restart
    of the logger is none.
    """
    if counts.size < 2 or counts.min() < 0:
        return counts, 0
    steps = np.diff(counts)
    back = np.flatnonzero(steps < 0)
    if not back.size:
        return counts, 0
    forward = steps[steps > 0]
    usual = int(np.median(forward)) if forward.size else 1
    for bits in (8, 16, 32):
        period = 1 << bits
        if counts.max() >= period:
            continue
        over = steps[back] + period
        # Some samples may be missing at the very wrap.
        wraps = back[(over > 0) & (over <= max(100 * usual, period // 64))]
        if not wraps.size:
            continue
        turns = np.zeros(counts.size, dtype=np.int64)
        turns[wraps + 1] = period
        return counts + np.cumsum(turns), int(wraps.size)
    return counts, 0


def to_ns(values: Numbers, ns: int) -> IntArray:
    """Return times counted in units of `ns` ns as int64 ns, shape (n,).

    Integers stay exact. Floats are split first, so that nothing is lost beyond their own resolution.
    """
    if values.dtype.kind == "i":
        if values.size and max(abs(int(values.max())), abs(int(values.min()))) > (1 << 62) // ns:
            values = values - values[0]
        return np.asarray(values, dtype=np.int64) * ns if ns != 1 else np.asarray(values, dtype=np.int64)
    whole = np.floor(values)
    limit = float((1 << 62) // ns)
    whole = np.where(np.abs(whole) < limit, whole, 0.0)
    return whole.astype(np.int64) * ns + np.round((values - np.floor(values)) * ns).astype(np.int64)


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

"""Columns of a time -> stamps in ns; errors about its unit name every reading."""

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from imucal.arrays import IntArray
from imucal.errors import ChoiceError, Fix
from imucal.findings import Finding
from imucal.readers.clocks.period import LIKELY_RATES
from imucal.readers.files import refused
from imucal.readers.fixes import GIVE_RATE, GIVE_TIME_UNIT, NAME_TIME
from imucal.readers.tables.stamps import (
    Numbers,
    TimeChoice,
    infer_time_unit,
    pair_stamps,
    rates_by_unit,
    text_stamps,
    to_ns,
    typical_step,
    unwrapped,
)
from imucal.readers.work import Work
from imucal.recording import Sensor
from imucal.units import TIME_UNITS_NS, time_unit_name, time_unit_ns

#: Largest relative difference between the given rate and the rate in a time unit.
_RATE_TOLERANCE = 0.1

#: A second in ns, the unit of stamps.
SECOND = 10**9
#: Above any sensor's rate.
_MAX_RATE_HZ = 1e6
#: About 30 years, within 64 bits.
_MAX_TIME_NS = 1e18


def stamps_of(
    work: Work, place: str, time: TimeChoice | None, columns: Sequence[Numbers], sensor: Sensor
) -> IntArray | None:
    """Return stamps in ns; None without a time, or if the given rate contradicts the counts in every unit.

    Raises ChoiceError at `place` if the unit is ambiguous.
    """
    if time is None:
        return None
    if time.kind == "ns":
        return cast("IntArray", columns[0])
    if time.kind == "text":
        return text_stamps(cast("Sequence[IntArray]", columns))
    if time.kind == "pair":
        return pair_stamps(columns[0], columns[1], time.ns, text=time.ns_source.startswith("text"))
    values = columns[0]
    if values.dtype.kind == "i":
        values, wraps = unwrapped(cast("IntArray", values))
        if wraps:
            again = f"Column {time.name} started again {wraps} times at the end of its range"
            work.findings.append(Finding("info", "wrapped", f"{again}; it was unwrapped."))
    ns = _ns_per_count(work, place, time, values, sensor)
    return None if ns is None else to_ns(values, ns)


def _ns_per_count(work: Work, place: str, time: TimeChoice, values: Numbers, sensor: Sensor) -> int | None:
    """Return ns per count; None if no unit gives the given rate. Raises ChoiceError if it is ambiguous."""
    rate = work.options.rate_hz
    stated_ns, how = time.ns, time.ns_source
    if work.options.time_unit is not None:
        stated_ns, how = time_unit_ns(work.options.time_unit), "as given"
    elif stated_ns is None and rate is not None:
        candidates = time.either_ns or tuple(TIME_UNITS_NS.values())
        stated_ns, how = _ns_of_rate(values, candidates, rate), "from the given rate"
    unclear = bool(time.either_ns or time.unknown_unit)
    fits: tuple[str, ...] = ()
    if stated_ns is None and not unclear:
        unit, fits = infer_time_unit(values)
        stated_ns = TIME_UNITS_NS[unit] if unit is not None else None
        how = "inferred from its size and its steps"
    if stated_ns is not None:
        work.decide("time unit", f"{time_unit_name(stated_ns)} for {time.name}, {how}")
        return stated_ns
    if rate is None and unclear:
        raise _unclear_unit(place, time, values, sensor)
    step = typical_step(values)
    if rate is None:
        raise _open_unit(place, time, values, fits, sensor)
    if values.dtype.kind == "i" and abs(step - 1) < 1e-3:
        work.decide("time unit", f"{time.name} counts samples at the given rate")
        return max(1, round(SECOND / rate))
    found = f"Column {time.name} increases by {step:g} per row, which is not {rate:g} Hz in any unit"
    text = f"{found}; it is ignored, so gaps are not found."
    work.findings.append(Finding("warning", "time-unused", text))
    return None


def _ns_of_rate(values: Numbers, candidates: Sequence[int], rate_hz: float) -> int | None:
    """Return the ns per count, of some candidates, with which the counts have a rate; None if none has."""
    step = typical_step(values)
    fits = (ns for ns in candidates if step > 0 and abs(1e9 / (step * ns) / rate_hz - 1) <= _RATE_TOLERANCE)
    return next(fits, None)


def _unclear_unit(place: str, time: TimeChoice, values: Numbers, sensor: Sensor) -> ChoiceError:
    """Return the error for a time with two readings, or with an unknown unit in its name."""
    step = typical_step(values)
    if time.either_ns:
        readings = " or ".join(
            f"{1e9 / (step * ns):.6g} Hz in steps of {time_unit_name(ns)}" for ns in time.either_ns
        )
        problem = f"increases by {step:g} per row, which is {readings}"
    else:
        problem = f"increases by {step:g} per row, and {time.unknown_unit!r} in its name is not a known unit"
    text = f"column {time.name!r}, the time of the {sensor}, {problem}"
    return refused(place, text, ChoiceError, GIVE_TIME_UNIT, GIVE_RATE)


#: Period of the clocks of .NET, FILETIME and Windows' performance counter, in ns.
_TICK_NS = 100


def _with_ticks(proposed: dict[str, float], rates: Mapping[str, float]) -> dict[str, float]:
    """Return units and their rates, first ticks of 100 ns if only they give the usual rate of an IMU."""
    slowest, fastest = LIKELY_RATES
    tick_rate = rates.get("ns", 0.0) / _TICK_NS
    usual = any(slowest < rate <= fastest for rate in proposed.values())
    return (
        proposed if usual or not slowest <= tick_rate <= fastest else {f"{_TICK_NS}ns": tick_rate} | proposed
    )


def _open_unit(
    place: str, time: TimeChoice, values: Numbers, fits: Sequence[str], sensor: Sensor
) -> ChoiceError:
    """Return the error for an ambiguous time unit; each suggestion in it works on this log."""
    span = float(values.max() - values.min())
    rates = {
        unit: rate
        for unit, rate in rates_by_unit(values).items()
        if rate <= _MAX_RATE_HZ and span * TIME_UNITS_NS[unit] < _MAX_TIME_NS
    }
    likely = fits or sorted(rates, key=lambda unit: abs(np.log10(rates[unit] / 100)))[:2]
    proposed = {unit: rates[unit] for unit in rates if unit in likely}
    if values.dtype.kind == "i":
        proposed = _with_ticks(proposed, rates)
    choices = " or ".join(f"{rate:.6g} Hz in {unit}" for unit, rate in proposed.items())
    name = time.name.strip().strip("\"'")
    fixes = [GIVE_TIME_UNIT, GIVE_RATE] if rates else [NAME_TIME, GIVE_RATE]
    if rates and fits and not name.isdigit():
        fixes.insert(1, Fix(f"name it in the header, such as {name}_{likely[0]}"))
    has = f"the time of the {sensor}, has no unit and increases by {typical_step(values):g} per row"
    which = choices if rates else "not a usual rate in any unit"
    return refused(place, f"column {time.name!r}, {has}, which is {which}", ChoiceError, *fixes)

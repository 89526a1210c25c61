"""Stamps -> clock: the rate, the gaps, and what was seen."""

from imucal.readers.clocks.from_stamps import (
    LOG_TIME,
    ClockReading,
    clock_from_stamps,
    compare_clocks,
    gap_notes,
    part_between,
    repeats,
)
from imucal.readers.clocks.period import estimate_period

__all__ = [
    "LOG_TIME",
    "ClockReading",
    "clock_from_stamps",
    "compare_clocks",
    "estimate_period",
    "gap_notes",
    "part_between",
    "repeats",
]

"""Stamps -> clock: the rate, the gaps, and what was seen."""

from imucal.readers.clocks.from_stamps import (
    LOG_TIME,
    ClockReading,
    clock_from_stamps,
    compare_clocks,
    repeats,
)

__all__ = [
    "LOG_TIME",
    "ClockReading",
    "clock_from_stamps",
    "compare_clocks",
    "repeats",
]

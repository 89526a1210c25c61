"""Dates and times of day as people and loggers write them -> ns."""

import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np

from imucal.arrays import IntArray

#: What the cells of a column of text are: a date with a time of day or a time of day alone, a date alone,
#: or AM and PM.
TextKind: TypeAlias = Literal["stamp", "date", "half"]

#: ns of a text that is no time.
NO_STAMP = int(np.iinfo(np.int64).min)

_SECOND = 10**9
HALF_DAY = 43_200 * _SECOND

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

#: Year first; or day and month in either order, the year last; or a month by its name, as MATLAB writes it.
_DATE = (
    r"(?:(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})"
    r"|(?P<one>\d{1,2})(?P<mark>[-/.])(?P<two>\d{1,2})(?P=mark)(?P<late>\d{4})"
    r"|(?P<dayn>\d{1,2})[- ](?P<name>[A-Za-z]{3})[- ](?P<yearn>\d{4}))"
)
_HALF = r"(?P<half>[AaPp])\.?[Mm]\.?"
#: Time of day, fraction; the separators differ from logger to logger.
_TIME = (
    r"(?P<hour>\d{1,2})[:.-](?P<minute>\d{2})[:.-](?P<second>\d{2})(?:[.,:_](?P<fraction>\d{1,12}))?"
    rf"(?:\s*{_HALF})?\s*(?:Z|UTC|GMT|(?P<zone>[+-]\d{{2}}:?\d{{2}}))?"
)
_STAMP = re.compile(rf"\s*(?:{_DATE}(?:[T _]+|, +))?{_TIME}\s*")
_DATE_ONLY = re.compile(rf"\s*{_DATE}\s*")
_HALF_ONLY = re.compile(rf"\s*{_HALF}\s*")


def is_text_stamp(cell: str) -> bool:
    """Return whether a cell is a date with a time of day, or a time of day."""
    return _STAMP.fullmatch(_bare(cell)) is not None


def is_time_of_day(cell: str) -> bool:
    """Return whether a cell is a time of day without a date."""
    match = _STAMP.fullmatch(_bare(cell))
    return match is not None and not _has_date(match)


def text_kind(cells: Sequence[str]) -> TextKind:
    """Return what the filled cells of a column of text are; ``stamp`` where they are nothing else."""
    filled = [_bare(cell) for cell in cells if cell]
    if filled and all(_DATE_ONLY.fullmatch(cell) for cell in filled):
        return "date"
    return "half" if filled and all(_HALF_ONLY.fullmatch(cell) for cell in filled) else "stamp"


def day_first(cells: Sequence[str]) -> bool | None:
    """Return whether dates such as 11/12/2026 begin with the day; None where the cells leave it open.

    A number above 12 is a day; points stand between day, month and year.
    """
    matches = [_DATE_ONLY.match(_bare(cell)) for cell in cells if cell]
    dates = [match for match in matches if match is not None and match["mark"]]
    if any(int(match["one"]) > 12 or match["mark"] == "." for match in dates):
        return True
    return None if dates and all(int(match["two"]) <= 12 for match in dates) else False


def parse_texts(cells: Sequence[str], kind: TextKind = "stamp", *, by_day: bool = False) -> IntArray:
    """Return times as ns since 1970, or since midnight where there is no date; shape (n,).

    A date alone is its midnight, PM half a day. A text that is no time becomes the smallest int64. Dates
    with the year last begin with the month, or `by_day`.
    """
    convert = _CONVERTERS[kind]
    result = np.empty(len(cells), dtype=np.int64)
    for i, cell in enumerate(cells):
        result[i] = convert(_bare(cell), by_day)
    return result


def _bare(cell: str) -> str:
    return cell.strip("\"'")


def _has_date(match: re.Match[str]) -> bool:
    return bool(match["year"] or match["late"] or match["name"])


def _of_stamp(cell: str, by_day: bool) -> int:  # noqa: FBT001 - one signature for all converters
    match = _STAMP.fullmatch(cell)
    if match is None:
        return NO_STAMP
    day = _day(match, by_day) if _has_date(match) else 0
    if day == NO_STAMP:
        return NO_STAMP
    fraction = int(((match["fraction"] or "") + "0" * 9)[:9])
    hour = int(match["hour"])
    if match["half"]:
        hour = hour % 12 + (12 if match["half"] in "pP" else 0)
    seconds = hour * 3600 + int(match["minute"]) * 60 + int(match["second"])
    if match["zone"]:
        sign = -1 if match["zone"][0] == "+" else 1
        digits = match["zone"][1:].replace(":", "")
        seconds += sign * (int(digits[:2]) * 3600 + int(digits[2:]) * 60)
    return (day * 86_400 + seconds) * _SECOND + fraction


def _of_date(cell: str, by_day: bool) -> int:  # noqa: FBT001 - one signature for all converters
    match = _DATE_ONLY.fullmatch(cell)
    day = _day(match, by_day) if match is not None else NO_STAMP
    return day if day == NO_STAMP else day * 86_400 * _SECOND


def _of_half(cell: str, by_day: bool) -> int:  # noqa: FBT001 - one signature for all converters
    del by_day
    match = _HALF_ONLY.fullmatch(cell)
    return NO_STAMP if match is None else HALF_DAY * (match["half"] in "pP")


_CONVERTERS: dict[TextKind, Callable[[str, bool], int]] = {
    "stamp": _of_stamp,
    "date": _of_date,
    "half": _of_half,
}


def _day(match: re.Match[str], by_day: bool) -> int:  # noqa: FBT001 - as above
    """Return the days since 1970 of a date."""
    if match["year"]:
        return _days_since_1970(match["year"], match["month"], match["day"])
    if match["name"]:
        name = match["name"].lower()
        month = _MONTHS.index(name) + 1 if name in _MONTHS else 0
        return _days_since_1970(match["yearn"], str(month), match["dayn"])
    one, two = match["one"], match["two"]
    month_text, day = (two, one) if by_day else (one, two)
    return _days_since_1970(match["late"], month_text, day)


@lru_cache
def _days_since_1970(year: str, month: str, day: str) -> int:
    try:
        return int(np.datetime64(f"{year}-{int(month):02d}-{int(day):02d}", "D").astype(np.int64))
    except ValueError:
        return NO_STAMP

"""Dates and times of day as people and loggers write them -> ns."""

import re
from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Literal, TypeAlias

import numpy as np

from imucal.arrays import IntArray

#: What the cells of a column of text are: a date with a time of day or a time of day alone, a date alone,
#: or AM and PM.
TextKind: TypeAlias = Literal["stamp", "date", "half"]

#: ns of a text that is no time.
NO_STAMP = int(np.iinfo(np.int64).min)

_SECOND = 10**9
DAY = 86_400 * _SECOND
HALF_DAY = DAY // 2
_MOST_DAYS = (1 << 63) // DAY - 100

_MONTHS = ("", "jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

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
_PATTERNS: dict[TextKind, re.Pattern[str]] = {
    "stamp": re.compile(rf"\s*(?:{_DATE}(?:[T _]+|, +))?{_TIME}\s*"),
    "date": re.compile(rf"\s*{_DATE}\s*"),
    "half": re.compile(rf"\s*{_HALF}\s*"),
}


def is_text_stamp(cell: str) -> bool:
    """Return whether a cell is a date with a time of day, or a time of day."""
    return _PATTERNS["stamp"].fullmatch(_bare(cell)) is not None


def is_time_of_day(cell: str) -> bool:
    """Return whether a cell is a time of day without a date."""
    match = _PATTERNS["stamp"].fullmatch(_bare(cell))
    return match is not None and not _has_date(match)


def text_kind(cells: Sequence[str]) -> TextKind:
    """Return what the filled cells of a column of text are; ``stamp`` where they are nothing else."""
    filled = [_bare(cell) for cell in cells if cell]
    kinds: tuple[TextKind, ...] = ("date", "half")
    return next((kind for kind in kinds if filled and all(map(_PATTERNS[kind].fullmatch, filled))), "stamp")


def day_first(cells: Sequence[str]) -> bool | None:
    """Return whether dates such as 11/12/2026 begin with the day; None where the cells leave it open.

    A number above 12 is a day; points stand between day, month and year.
    """
    matches = [_PATTERNS["date"].match(_bare(cell)) for cell in cells if cell]
    dates = [match for match in matches if match is not None and match["mark"]]
    if any(int(match["one"]) > 12 or match["mark"] == "." for match in dates):
        return True
    return None if dates and all(int(match["two"]) <= 12 for match in dates) else False


def parse_texts(cells: Sequence[str], kind: TextKind = "stamp", *, by_day: bool = False) -> IntArray:
    """Return times as ns since 1970, or since midnight where there is no date; shape (n,).

    A date alone is its midnight, PM half a day. A text that is no time becomes the smallest int64. Dates
    with the year last begin with the month, or `by_day`.
    """
    parse = partial(_ns, kind=kind, by_day=by_day)
    return np.fromiter(map(parse, cells), dtype=np.int64, count=len(cells))


def _bare(cell: str) -> str:
    return cell.strip("\"'")


def _has_date(match: re.Match[str]) -> bool:
    return bool(match["year"] or match["late"] or match["name"])


def _ns(cell: str, *, kind: TextKind, by_day: bool) -> int:
    match = _PATTERNS[kind].fullmatch(_bare(cell))
    if match is None:
        return NO_STAMP
    if kind == "half":
        return HALF_DAY * (match["half"] in "pP")
    day = _day(match, by_day=by_day) if _has_date(match) else 0
    # 64 bits of ns hold the years from 1678 to 2261.
    if abs(day) > _MOST_DAYS:
        return NO_STAMP
    return day * DAY + (_of_day(match) if kind == "stamp" else 0)


def _of_day(match: re.Match[str]) -> int:
    """Return a time of day in ns; what its time zone is ahead of UTC is taken off."""
    hour = int(match["hour"])
    if match["half"]:
        hour = hour % 12 + (12 if match["half"] in "pP" else 0)
    seconds = hour * 3600 + int(match["minute"]) * 60 + int(match["second"])
    if match["zone"]:
        sign = -1 if match["zone"][0] == "+" else 1
        digits = match["zone"][1:].replace(":", "")
        seconds += sign * (int(digits[:2]) * 3600 + int(digits[2:]) * 60)
    return seconds * _SECOND + int(f"{match['fraction'] or '':0<9}"[:9])


def _day(match: re.Match[str], *, by_day: bool) -> int:
    """Return the days since 1970 of a date."""
    if match["year"]:
        return _days_since_1970(match["year"], match["month"], match["day"])
    if match["name"]:
        name = match["name"].lower()
        month = str(_MONTHS.index(name)) if name in _MONTHS else ""
        return _days_since_1970(match["yearn"], month, match["dayn"])
    month, day = (match["two"], match["one"]) if by_day else (match["one"], match["two"])
    return _days_since_1970(match["late"], month, day)


@lru_cache
def _days_since_1970(year: str, month: str, day: str) -> int:
    try:
        return int(np.datetime64(f"{year}-{int(month):02d}-{int(day):02d}", "D").astype(np.int64))
    except ValueError:
        return NO_STAMP

"""Numbers with units as users type them: 90s, 5 min, 2G, 10 %, 360deg."""

import math
import re
from collections.abc import Mapping

from imucal.errors import ArgumentError

__all__ = ["bytes_of", "quantity", "seconds_of", "split_number"]

#: A number without the words nan and infinity, and the text after it.
_NUMBER = re.compile(r"(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>.*)", re.DOTALL)

_TIMES = {"": 1.0, "s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
#: Powers of 1024, as the tools of operating systems print them.
_SIZES = {
    f"{prefix}{ending}": 1024.0**power
    for power, prefix in enumerate(("", "k", "m", "g", "t"))
    for ending in ("", "b", "ib")
}


def split_number(text: str) -> tuple[float, str] | None:
    """Return the number at the start of a text and the unit after it, or None without a number."""
    match = _NUMBER.fullmatch(text.strip())
    if match is None:
        return None
    return float(match["number"]), match["unit"]


def quantity(text: str, units: Mapping[str, float], *, any_case: bool = False) -> float | None:
    """Return a number times the factor of its unit; None for another text, unit, or an infinite product.

    `units` maps names to factors; the name "" allows a number without a unit. With `any_case`, the names are
    in lower case and the text in any.
    """
    parts = split_number(text)
    if parts is None:
        return None
    number, unit = parts
    factor = units.get(unit.lower() if any_case else unit)
    if factor is None or not math.isfinite(number * factor):
        return None
    return number * factor


def seconds_of(text: str | float) -> float:
    """Return a duration in s from a number, alone or with s, min, m, h or d; raises ArgumentError."""
    text = str(text).strip()
    seconds = quantity(text, _TIMES)
    if seconds is None or seconds < 0:
        raise ArgumentError(f"{text!r} is not a duration; write seconds, or for example 90s, 5min, 2.5h")
    return seconds


def bytes_of(text: str, *, least: int = 1) -> int:
    """Return a size such as ``500M`` or ``2GB`` in bytes; a K is 1024.

    Raises ValueError if the text is not a size, or the size is less than `least`.
    """
    size = quantity(text, _SIZES, any_case=True)
    if size is None or size < least:
        raise ValueError("a size such as 500M or 2G")
    return int(size)

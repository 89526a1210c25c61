"""How numbers and comments are spelled, so that the consumers' own parsers read them."""

import json
import math
from collections.abc import Iterable, Sequence
from decimal import Decimal


def real(value: float) -> str:
    """Return a number with a decimal point that reads back exactly: ``200.0``, ``1.0e-05``.

    OpenCV's FileStorage takes ``200`` for an integer, and YAML 1.1 takes ``1e-05`` for a string;
    with the point both read a real number.
    """
    if not math.isfinite(value):
        msg = f"only finite numbers can be written, got {value}"
        raise ValueError(msg)
    mantissa, sign, exponent = repr(float(value)).partition("e")
    if "." not in mantissa:
        mantissa += ".0"
    return f"{mantissa}e{int(exponent):+03d}" if sign else mantissa


def decimal(value: float) -> str:
    """Return a number without an exponent, for parsers that know none: ``0.00001``."""
    digits = format(Decimal(real(value)), "f")
    return digits if "." in digits else digits + ".0"


def vector(values: Iterable[float]) -> str:
    """Return ``[1.0, 2.0, 3.0]``."""
    return "[" + ", ".join(real(value) for value in values) + "]"


def matrix(rows: Sequence[Sequence[float]], indent: str) -> list[str]:
    """Return a YAML list of lists, one row a line."""
    return [f"{indent}- {vector(row)}" for row in rows]


def quoted(text: str) -> str:
    """Return a double-quoted scalar, right in YAML, in JSON and for OpenCV."""
    return json.dumps(text, ensure_ascii=False)


def plain(text: str) -> str:
    """Return text that stays on its line: control characters become spaces."""
    return "".join(sign if sign.isprintable() else " " for sign in text)


def comment(lines: Iterable[str], sign: str = "#") -> list[str]:
    """Return the lines as comments."""
    return [f"{sign} {plain(line)}".rstrip() for line in lines]

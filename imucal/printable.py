"""Make text from files, such as names of topics and columns, safe for terminals and pages."""

import unicodedata
from collections.abc import Callable

#: Unicode categories of control and direction characters.
_STEERING = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
_LAYOUT = frozenset("\n\t")


def printable(text: str) -> str:
    """Return a text with Python's escapes instead of control characters, except line breaks and tabs."""
    return _escaped(text, lambda sign: sign.encode("unicode_escape").decode("ascii"))


def one_line(text: str) -> str:
    """Return text that stays on its line: control characters become spaces."""
    return "".join(sign if sign.isprintable() else " " for sign in text)


def printable_json(text: str) -> str:
    """Return a JSON text of the same value with JSON's escapes instead of control characters."""
    return _escaped(text, _json_escape)


def _escaped(text: str, escape: Callable[[str], str]) -> str:
    if text.replace("\n", "").isprintable():
        return text
    steering = {sign for sign in {*text} - _LAYOUT if unicodedata.category(sign) in _STEERING}
    return "".join(escape(sign) if sign in steering else sign for sign in text)


def _json_escape(sign: str) -> str:
    code = sign.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{code[i : i + 4]}" for i in range(0, len(code), 4))

"""Text of others, such as names of topics, columns and files, as a terminal or a page may show it."""

import unicodedata
from collections.abc import Callable

#: Categories of signs that steer a terminal or turn text round instead of showing something.
_STEERING = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
#: Signs of our own that lay out lines.
_LAYOUT = frozenset("\n\t")


def printable(text: str) -> str:
    """Return a text in which signs that steer a terminal stand as Python's escapes; its lines stay."""
    return _escaped(text, lambda sign: sign.encode("unicode_escape").decode("ascii"))


def one_line(text: str) -> str:
    """Return text that stays on its line: control characters become spaces."""
    return "".join(sign if sign.isprintable() else " " for sign in text)


def printable_json(text: str) -> str:
    """Return a JSON text of the same value in which such signs stand as JSON's escapes."""
    return _escaped(text, _json_escape)


def _escaped(text: str, escape: Callable[[str], str]) -> str:
    if text.replace("\n", "").isprintable():
        return text
    steering = {sign for sign in {*text} - _LAYOUT if unicodedata.category(sign) in _STEERING}
    return "".join(escape(sign) if sign in steering else sign for sign in text)


def _json_escape(sign: str) -> str:
    """Return the escape of a sign: two of them beyond 16 bits, as JSON counts in UTF-16."""
    code = sign.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{code[i : i + 4]}" for i in range(0, len(code), 4))

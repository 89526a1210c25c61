"""Text of others, such as names of topics, columns and files, as a terminal or a page may show it."""

import unicodedata

#: Categories of signs that steer a terminal or turn text round instead of showing something.
_STEERING = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
#: Signs of our own that lay out lines.
_LAYOUT = frozenset("\n\t")


def printable(text: str) -> str:
    """Return a text in which signs that steer a terminal stand as Python's escapes; its lines stay."""
    if text.replace("\n", "").isprintable():
        return text
    return "".join(sign if _is_shown(sign) else _escape(sign) for sign in text)


def printable_json(text: str) -> str:
    """Return a JSON text of the same value in which such signs stand as JSON's escapes."""
    if text.replace("\n", "").isprintable():
        return text
    return "".join(sign if _is_shown(sign) else _json_escape(sign) for sign in text)


def _is_shown(sign: str) -> bool:
    return sign in _LAYOUT or unicodedata.category(sign) not in _STEERING


def _escape(sign: str) -> str:
    return sign.encode("unicode_escape").decode("ascii")


def _json_escape(sign: str) -> str:
    """Return the escape of a sign: two of them beyond 16 bits, as JSON counts in UTF-16."""
    code = sign.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{code[i : i + 4]}" for i in range(0, len(code), 4))

"""Tests of control characters: they are escaped for terminals and keep their value in JSON."""

import json

import pytest

from imucal.printable import printable, printable_json


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("gyro_x [rad/s] √²µ ° 加速度", "gyro_x [rad/s] √²µ ° 加速度"),
        ("two\nlines\tand a tab", "two\nlines\tand a tab"),
        ("\x1b[2J", "\\x1b[2J"),
        ("a\rb\bc\x07\x7f", "a\\rb\\x08c\\x07\\x7f"),
        ("\x9b31m", "\\x9b31m"),
        ("\u202egnp\u2028\ufeff", "\\u202egnp\\u2028\\ufeff"),
        ("\udce9.csv", "\\udce9.csv"),
        ("\U000e0041", "\\U000e0041"),
    ],
)
def test_control_characters_are_escaped(text: str, escaped: str) -> None:
    """Letters of all scripts and line breaks are unchanged, and the result has no control characters."""
    assert printable(text) == escaped
    assert printable(printable(text)) == escaped


@pytest.mark.parametrize("text", ["plain", "\x1b\x9b\x7f\u202e\u2028", "\U000e0041\ufeff", "\udce9"])
def test_json_keeps_its_value(text: str) -> None:
    """JSON's own escapes are used, two of them for characters beyond 16 bits."""
    written = printable_json(json.dumps({"name": text}, ensure_ascii=False))
    assert written.isprintable()
    assert json.loads(written) == {"name": text}

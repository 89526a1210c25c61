"""Signs that steer a terminal: shown as escapes, and the same value in JSON."""

import json

import pytest

from imucal.printable import printable, printable_json


@pytest.mark.parametrize(
    ("text", "shown"),
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
def test_what_steers_is_shown_as_an_escape(text: str, shown: str) -> None:
    """Letters of any script and lines stay; what is shown steers nothing."""
    assert printable(text) == shown
    assert printable(printable(text)) == shown


@pytest.mark.parametrize("text", ["plain", "\x1b\x9b\x7f\u202e\u2028", "\U000e0041\ufeff", "\udce9"])
def test_json_keeps_its_value(text: str) -> None:
    """The escapes are JSON's own: two of them beyond 16 bits."""
    written = printable_json(json.dumps({"name": text}, ensure_ascii=False))
    assert written.isprintable()
    assert json.loads(written) == {"name": text}

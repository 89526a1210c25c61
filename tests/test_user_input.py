"""Numbers with units as users type them."""

import math

import pytest

from imucal.errors import ArgumentError
from imucal.user_input import bytes_of, quantity, seconds_of, split_number


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("90", (90.0, "")),
        (" 1.5e-3 deg/s ", (1.5e-3, "deg/s")),
        (".5g", (0.5, "g")),
        ("-2", (-2.0, "")),
        # The e of a unit is no exponent without digits.
        ("3ev", (3.0, "ev")),
        ("5 min\n", (5.0, "min")),
        ("nan", None),
        ("inf s", None),
        ("", None),
        ("1_000", (1.0, "_000")),
    ],
)
def test_a_number_is_split_from_its_unit(text: str, parts: tuple[float, str] | None) -> None:
    assert split_number(text) == parts


def test_only_the_given_units_are_accepted() -> None:
    """A number without a unit must be allowed, and the case matters unless it is said not to."""
    units = {"s": 1.0, "ms": 1e-3}
    assert quantity("250 ms", units) == pytest.approx(0.25)
    assert quantity("250", units) is None
    assert quantity("250 MS", units) is None
    assert quantity("250 MS", units, any_case=True) == pytest.approx(0.25)
    assert quantity("1e308", {"": 100.0}) is None


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("90", 90.0),
        (90, 90.0),
        ("90s", 90.0),
        ("5 min", 300.0),
        ("5m", 300.0),
        ("2.5h", 9000.0),
        ("1d", 86400.0),
    ],
)
def test_durations_are_in_seconds(text: str | float, seconds: float) -> None:
    assert seconds_of(text) == seconds


@pytest.mark.parametrize("text", ["", "s", "-1s", "1 hour", "5 M", "nan", math.inf, "1:30"])
def test_other_texts_are_no_durations(text: str | float) -> None:
    with pytest.raises(ArgumentError):
        seconds_of(text)


@pytest.mark.parametrize(
    ("text", "size"),
    [("500", 500), ("1k", 1024), ("1 KiB", 1024), ("2GB", 2 << 30), ("0.5T", 1 << 39), ("10B", 10)],
)
def test_sizes_are_in_bytes(text: str, size: int) -> None:
    assert bytes_of(text) == size


@pytest.mark.parametrize("text", ["", "G", "-1", "1 PB", "0", "two"])
def test_other_texts_are_no_sizes(text: str) -> None:
    """Zero is a size only where it means something."""
    with pytest.raises(ValueError, match="500M"):
        bytes_of(text)
    if text == "0":
        assert bytes_of(text, least=0) == 0

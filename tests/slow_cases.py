"""Parameters of which only the first run by default; the others are marked as slow."""

from collections.abc import Iterable
from typing import Any

import pytest

__all__ = ["first_by_default"]


def first_by_default(values: Iterable[Any], number: int) -> list[Any]:
    """Return the values as parameters, all but the first `number` with the mark ``slow``."""
    return [
        value if place < number else pytest.param(value, marks=[pytest.mark.slow])
        for place, value in enumerate(values)
    ]

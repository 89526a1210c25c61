"""Parameters that are marked as slow except the first ones."""

from collections.abc import Iterable
from typing import Any

import pytest

__all__ = ["first_by_default"]


def first_by_default(values: Iterable[Any], number: int) -> list[Any]:
    """Return the values as parameters; all after the first `number` have the mark ``slow``."""
    return [
        value if place < number else pytest.param(value, marks=[pytest.mark.slow])
        for place, value in enumerate(values)
    ]

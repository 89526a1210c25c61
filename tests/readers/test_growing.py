"""Columns that grow keep every value."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.readers import growing
from imucal.readers.growing import GrowingColumn


@pytest.fixture(autouse=True)
def small_first_capacity(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let columns grow after a hundred values."""
    monkeypatch.setattr(growing, "_FIRST", 100)


@pytest.mark.parametrize("expected", [0, 120, 10_000])
def test_a_growing_column_becomes_float_with_its_earlier_integers(expected: int) -> None:
    column = GrowingColumn(np.int64, expected=expected)
    blocks = [np.arange(0, 150), np.arange(150, 200), np.linspace(0.5, 9.5, 70), np.arange(5)]
    for block in blocks:
        column.append(block)
    taken = column.take()
    assert taken.dtype == np.float64
    npt.assert_array_equal(taken, np.concatenate(blocks))


@pytest.mark.parametrize("expected", [0, 1000])
def test_integers_stay_integers(expected: int) -> None:
    """A float has too few digits for stamps in ns."""
    column = GrowingColumn(np.int64, expected=expected)
    stamps = 1_700_000_000_000_000_001 + np.arange(1000)
    for block in np.split(stamps, 4):
        column.append(block)
    npt.assert_array_equal(column.take(), stamps)

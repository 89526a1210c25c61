"""Recognition of rows without names from known loggers, and columns of arrays."""

import numpy as np
import pytest

from imucal.readers.tables.dialects import _is_ros2
from imucal.readers.tables.layout import TextLayout
from imucal.readers.tables.typed_table import _of_array


@pytest.mark.parametrize(
    ("start", "width", "fits"),
    [
        (["1", "2", "imu"], 40, True),
        (["1", "2", "3"], 40, False),
        (["1.5", "2", "imu"], 40, False),
        (["1", "x", "imu"], 40, False),
        (["1", "2", "imu"], 39, False),
        (["1", "2", "imu", "x"], 40, False),
    ],
)
def test_rows_of_ros2_topic_echo_are_recognised(start: list[str], width: int, fits: bool) -> None:  # noqa: FBT001 - of the case
    """A row has seconds, nanoseconds, a frame name, and then only numbers."""
    row = (*start, *["0.5"] * (width - len(start)))
    assert _is_ros2(TextLayout(width=width, rows=(row,))) == fits


@pytest.mark.parametrize(
    ("shape", "names"),
    [
        ((9,), ["a"]),
        ((9, 1), ["a"]),
        ((1, 9), ["a"]),
        ((9, 3), ["a[0]", "a[1]", "a[2]"]),
        ((3, 9), ["a[0]", "a[1]", "a[2]"]),
        ((3, 3), ["a[0]", "a[1]", "a[2]"]),
        ((2, 2, 2), ["a[0,0]", "a[0,1]", "a[1,0]", "a[1,1]"]),
        ((1, 9, 2), ["a[:,0]", "a[:,1]"]),
        ((9, 4), ["a[:,0]", "a[:,1]", "a[:,2]", "a[:,3]"]),
        ((2, 9, 1, 2), ["a[0,0]", "a[0,1]", "a[1,0]", "a[1,1]"]),
        ((70, 71, 2), []),
        ((1, 1, 1), []),
        ((), []),
    ],
)
def test_columns_of_an_array_run_along_its_longer_dimension(shape: tuple[int, ...], names: list[str]) -> None:
    columns = _of_array("a", np.arange(np.prod(shape, dtype=int)).reshape(shape))
    assert [column.name for column in columns] == names
    assert {column.values.size for column in columns} <= {max(shape, default=0)}

"""Rows of sensors selected by a tag: in any kind of table, and a tag that no row has."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from imucal.errors import ChoiceError
from imucal.readers import read
from tests.raising import raises
from tests.readers.tables.texts import N, truth

SENSORS: dict[str, Any] = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}


def write(path: Path) -> Path:
    """Write rows of two sensors, which alternate, with their tag in the second column."""
    true = truth()
    times = np.repeat(np.arange(N) / 100, 2)
    tags = ["GYR", "ACC"] * N
    values = np.stack([true.gyro, true.accel], axis=1).reshape(-1, 3)
    columns = {"t": times, "tag": tags, **dict(zip("abc", values.T, strict=True))}
    table = pl.DataFrame(columns)
    if path.suffix == ".parquet":
        table.write_parquet(path)
    else:
        table.write_csv(path)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("column", ["tag:", "1:", ""])
def test_rows_are_selected_by_their_tag(suffix: str, column: str, tmp_path: Path) -> None:
    """The tag is in a column by name or number, or in any column."""
    path = write(tmp_path / f"log{suffix}")
    recording = read(path, columns=f"t=0,g=2:5@{column}GYR,a=2:5@{column}ACC", **SENSORS)
    for sensor, values in (("gyroscope", truth().gyro), ("accelerometer", truth().accel)):
        for number, axis in enumerate("xyz"):
            np.testing.assert_array_equal(recording.axis(sensor, axis).samples, values[:, number])


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize(("tag", "where"), [("tag:MAG", "column tag"), ("MAG", "any column")])
def test_a_tag_that_no_row_has_is_refused(suffix: str, tag: str, where: str, tmp_path: Path) -> None:
    """The sensor must not be missing without a word."""
    path = write(tmp_path / f"log{suffix}")
    expected = f"no row has 'MAG' in {where}, which selects those of the accelerometer"
    with raises(ChoiceError, expected, place=path.name, argument="columns"):
        read(path, columns=f"t=0,g=2:5@tag:GYR,a=2:5@{tag}", **SENSORS)

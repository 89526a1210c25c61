"""Arrays that a child process passes in files equal those in the log."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.testing as npt
import polars as pl
import pytest

from imucal.readers.tables.typed_table import write_arrays

VALUES = np.random.default_rng(3).normal(size=(5, 401, 3))


def through(kind: str, path: Path) -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, str]]:
    """Return the arrays of a file and its objects."""
    folder = path.parent / "arrays"
    folder.mkdir()
    names, notes = write_arrays(kind, path, folder)
    files = [folder / f"{number}.npy" for number in range(len(names))]
    return dict(zip(names, map(np.load, files), strict=True)), notes.objects


@pytest.mark.parametrize("chunks", [None, True, (5, 7, 3), (1, 401, 1)])
@pytest.mark.parametrize("matlab", [False, True])
def test_datasets_of_any_shape_are_read(chunks: Any, tmp_path: Path, *, matlab: bool) -> None:  # noqa: ANN401 - of h5py
    """Datasets can be chunked; those of MATLAB are transposed."""
    path = tmp_path / "log.h5"
    pair = np.zeros(401, [("t", "<f8"), ("n", ">i4")])
    pair["n"] = np.arange(401)
    arrays = {
        "a": VALUES[0],
        "b": VALUES[0].T,
        "c": VALUES,
        "d": VALUES[0, :, 0].astype(">f4"),
        "e": np.arange(401) % 2 == 0,
        "f": pair,
        "g": np.float64(7),
        "h": np.zeros((0, 3)),
    }
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            stored = file.create_dataset(name, data=array, chunks=chunks if name == "c" else None)
            if matlab:
                stored.attrs["MATLAB_class"] = np.bytes_("double")
    found, objects = through("HDF5", path)
    assert not objects
    for name, array in arrays.items():
        expected = np.asarray(array).T if matlab else np.asarray(array)
        assert found[name].dtype == expected.dtype
        npt.assert_array_equal(found[name], expected)


def test_parquet_columns_of_all_types_are_read(tmp_path: Path) -> None:
    """Types: numbers, missing values, times, texts, structures and lists. Some columns are read at a time."""
    path = tmp_path / "log[1].parquet"
    table = pl.DataFrame(
        {
            "t": np.arange(401).astype("datetime64[us]"),
            "x": VALUES[0, :, 0],
            "gaps": pl.Series([None, *range(400)]),
            "text": ["a"] * 401,
            "pair": [{"u": i, "v": 2.5 * i} for i in range(401)],
            "list": pl.Series([[float(i)] * (i % 3) for i in range(401)]),
            "array": pl.Series(VALUES[0], dtype=pl.Array(pl.Float64, 3)),
        }
    )
    table.write_parquet(path)
    found, _ = through("Parquet", path)
    assert list(found) == [
        "t",
        "x",
        "gaps",
        "text",
        "pair.u",
        "pair.v",
        "list[0]",
        "list[1]",
        *(f"array[{i}]" for i in range(3)),
    ]
    npt.assert_array_equal(found["t"], table["t"].to_numpy())
    npt.assert_array_equal(found["gaps"], np.array([np.nan, *range(400)]))
    npt.assert_array_equal(found["array[2]"], VALUES[0, :, 2])
    assert found["text"].tolist() == ["a"] * 401
    assert found["pair.v"][2] == 5.0
    assert found["list[1]"][:4].tolist()[2] == 2.0

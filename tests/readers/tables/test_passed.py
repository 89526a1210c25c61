"""Arrays that a child process reads in parts equal those read at once."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.testing as npt
import polars as pl
import pytest

from imucal.readers.tables import passed, typed_table
from imucal.readers.tables.passed import cut, taken, written
from imucal.readers.tables.typed_table import write_arrays

pytestmark = pytest.mark.usefixtures("small_pieces")

VALUES = np.random.default_rng(3).normal(size=(5, 401, 3))


@pytest.fixture
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read a hundred numbers at a time."""
    monkeypatch.setattr(passed, "PIECE", 800)
    monkeypatch.setattr(typed_table, "PIECE", 800)


def through(kind: str, path: Path) -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, str]]:
    """Return the arrays of a file and its objects."""
    found, notes = write_arrays(kind, path, path.with_suffix(".arrays"))
    return taken(found, path.with_suffix(".arrays")), notes.objects


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


@pytest.mark.parametrize(("limit", "mapped"), [("1G", False), ("1k", True)])
def test_large_arrays_are_in_temporary_files(
    limit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, mapped: bool
) -> None:
    """Arrays in files have the same values as arrays in memory."""
    monkeypatch.setenv("IMUCAL_MEMORY", limit)
    parts = [("a", 1, [VALUES[0, :300], VALUES[0, 300:]]), ("text", 0, [np.array(["x", None])])]
    found = taken(written(parts, tmp_path / "arrays"), tmp_path / "arrays")
    npt.assert_array_equal(found["a"], np.moveaxis(VALUES[0], 0, 1))
    assert found["text"].tolist() == ["x", None]
    base = found["a"]
    while isinstance(base.base, np.ndarray):
        base = base.base
    assert base.flags.owndata != mapped


def test_a_truncated_file_of_arrays_is_refused(tmp_path: Path) -> None:
    """The disk may be full."""
    found = written([("a", 0, [VALUES[0]])], tmp_path / "arrays")
    (tmp_path / "arrays").write_bytes(b"12345")
    with pytest.raises(ValueError, match="an array ends after 5 of 9624 bytes"):
        taken(found, tmp_path / "arrays")


def test_slices_consist_of_complete_chunks() -> None:
    """Each chunk is unpacked once. A chunk larger than a part is read completely."""
    assert [(s.start, s.stop) for s in cut((250, 2), 8)] == [
        (0, 50),
        (50, 100),
        (100, 150),
        (150, 200),
        (200, 250),
    ]
    assert next(cut((250, 2), 8, 40)) == slice(0, 40)
    assert next(cut((250, 2), 8, 400)) == slice(0, 400)

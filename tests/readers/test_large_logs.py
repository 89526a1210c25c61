"""Small files that unpack to very large data: only the necessary part is read or kept in memory."""

import gzip
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.errors import ReadError
from imucal.readers import describe, description, isolation, read
from imucal.readers.tables import text_table
from imucal.readers.tables.notes import Notes
from imucal.readers.tables.npz import npz_arrays
from imucal.readers.tables.text_source import TextSource, open_text
from tests.cli.run import run
from tests.raising import raises
from tests.readers.logs import samples

TRUTH = samples(3000, seed=77)
TIMES = np.arange(3000) / 100
HEADER = "t,gx_rads,gy_rads,gz_rads,ax_ms2,ay_ms2,az_ms2"
NAMES = HEADER.split(",")


def table(rows: int = 3000) -> bytes:
    """Return a CSV of about 120 bytes per row."""
    lines = [f"{t},{','.join(map(repr, row))}" for t, row in zip(TIMES, TRUTH.all.tolist(), strict=True)]
    return "\n".join([HEADER, *lines[:rows], ""]).encode()


def arrays() -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """Return the columns of the log."""
    return dict(zip(NAMES, [TIMES, *TRUTH.all.T], strict=True))


@pytest.mark.parametrize("packed", ["gz", "zip"])
def test_the_head_describes_a_large_compressed_text(
    packed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the unpacked text exceeds a limit, its rows are not counted."""
    path = tmp_path / f"log.csv.{packed}"
    if packed == "gz":
        path.write_bytes(gzip.compress(table()))
    else:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("log.csv", table())
    complete = describe(path)
    assert complete.topics[0].count == 3000
    assert complete.topics[0].rate_hz == pytest.approx(100)
    monkeypatch.setattr(description, "_SMALL", 300_000)
    part = describe(path)
    assert (part.topics[0].count, part.duration_s) == (None, None)
    assert part.topics[0].rate_hz == pytest.approx(100)
    assert part.topics[0].sensors == complete.topics[0].sensors
    assert part.unpacked_bytes is not None
    assert part.unpacked_bytes > 300_000
    assert read(path).series[0].n == 3000


def test_unpacking_of_a_text_stops_at_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The text is twenty times longer than the limit."""
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(table() + b"31.0,0,0,0,0,0,9.8\n" * 1_000_000, compresslevel=1))
    monkeypatch.setattr(description, "_SMALL", 1_000_000)
    taken = []

    def watched(path: Path, **options: Any) -> TextSource:  # noqa: ANN401 - those of `open_text`
        taken.append(open_text(path, **options))
        return taken[-1]

    monkeypatch.setattr(text_table, "open_text", watched)
    assert describe(path).topics[0].count is None
    assert 1_000_000 < max(source.passed for source in taken) < 12_000_000


def test_a_member_with_a_huge_declared_size_is_refused(tmp_path: Path) -> None:
    """The size is checked before memory is allocated."""
    path = tmp_path / "log.npz"
    with zipfile.ZipFile(path, "w") as archive:
        header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
        head = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
        archive.writestr("gx.npy", head + bytes(80))
    with raises(ReadError, "8000000000000 bytes and contains 80", place="log.npz"):
        read(path)


def test_info_reads_no_samples_of_a_highly_compressed_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The output mentions that --gaps reads them."""
    np.savez_compressed(tmp_path / "log.npz", **arrays())  # type: ignore[arg-type]
    assert "no gaps" in run("info", "log.npz", cwd=tmp_path).stdout
    monkeypatch.setattr("imucal.cli.info._SMALL", 150_000)
    done = run("info", "log.npz", cwd=tmp_path)
    assert "Gaps were not checked" in done.stdout
    assert "no gaps" in run("info", "--gaps", "log.npz", cwd=tmp_path).stdout
    listed = json.loads(run("info", "--json", "log.npz", cwd=tmp_path).stdout)
    assert listed["logs"][0]["unpacked_bytes"] == 8 * 7 * 3000


@pytest.mark.parametrize("name", ["log.mat", "log.h5", "log.parquet"])
def test_a_file_that_unpacks_to_more_than_memory_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit applies to the child process, which can then read the next file."""
    import h5py
    import polars as pl
    import scipy.io

    path, zeros = tmp_path / name, np.zeros(6_000_000)
    if name == "log.mat":
        scipy.io.savemat(path, {"gyro": zeros}, do_compression=True)
    elif name == "log.h5":
        with h5py.File(path, "w") as file:
            file.create_dataset("gyro", data=zeros, compression="gzip")
    else:
        pl.DataFrame({"gyro": zeros}).write_parquet(path)
    assert path.stat().st_size < 1_000_000
    kind = {"log.mat": "MAT", "log.h5": "HDF5", "log.parquet": "Parquet"}[name]
    monkeypatch.setenv("IMUCAL_MEMORY", "1M")
    monkeypatch.setattr(isolation, "_OVERHEAD", -(1 << 20))
    for action in (read, describe):
        with raises(ReadError, f"not a readable {kind} file: ", place=name):
            action(path)
    monkeypatch.undo()
    pl.DataFrame(arrays()).write_parquet(tmp_path / "small.parquet")
    assert read(tmp_path / "small.parquet").series[0].n == 3000


def test_arrays_of_an_npz_file_are_exact(tmp_path: Path) -> None:
    """Compressed and uncompressed files work, in either memory order. A damaged member fails its checksum."""
    matrix = np.asfortranarray(TRUTH.all)
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "log.npz", m=matrix, t=TIMES, one=np.float64(7))
        found = npz_arrays(tmp_path / "log.npz", Notes())
        assert np.array_equal(found["m"], matrix)
        assert np.array_equal(found["t"], TIMES)
        assert found["one"] == 7
    data = bytearray((tmp_path / "log.npz").read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "log.npz").write_bytes(data)
    with raises(ReadError, "not a readable NPZ file", place="log.npz"):
        read(tmp_path / "log.npz")

"""A few bytes that unpack to very many: nothing reads, or holds, more than it needs."""

import gzip
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.errors import ReadError
from imucal.readers import describe, read
from imucal.readers.tables import text_table, typed_table
from imucal.readers.tables.foreign_files import MOST_GROWTH, npz_arrays, unpacks_to_more
from imucal.readers.tables.text_source import TextSource, open_text
from tests.cli.run import run
from tests.readers.logs import samples

TRUTH = samples(3000, seed=77)
TIMES = np.arange(3000) / 100
HEADER = "t,gx_rads,gy_rads,gz_rads,ax_ms2,ay_ms2,az_ms2"
NAMES = HEADER.split(",")


def table(rows: int = 3000) -> bytes:
    """Return a CSV of about 120 bytes a row."""
    lines = [f"{t},{','.join(map(repr, row))}" for t, row in zip(TIMES, TRUTH.all.tolist(), strict=True)]
    return "\n".join([HEADER, *lines[:rows], ""]).encode()


def arrays() -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """Return the columns of the log."""
    return dict(zip(NAMES, [TIMES, *TRUTH.all.T], strict=True))


@pytest.mark.parametrize("packed", ["gz", "zip"])
def test_a_text_is_described_by_its_head(
    packed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it is longer, unpacked, than is read without being asked; its rows are not counted."""
    path = tmp_path / f"log.csv.{packed}"
    if packed == "gz":
        path.write_bytes(gzip.compress(table()))
    else:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("log.csv", table())
    whole = describe(path)
    assert whole.topics[0].count == 3000
    assert whole.topics[0].rate_hz == pytest.approx(100)
    monkeypatch.setattr(text_table, "_SMALL", 300_000)
    part = describe(path)
    assert (part.topics[0].count, part.duration_s) == (None, None)
    assert part.topics[0].rate_hz == pytest.approx(100)
    assert part.topics[0].sensors == whole.topics[0].sensors
    assert part.unpacked_bytes is not None
    assert part.unpacked_bytes > 300_000
    assert read(path).series[0].n == 3000


def test_no_more_of_a_text_is_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty times what is wanted costs no more than a little above it."""
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(table() + b"31.0,0,0,0,0,0,9.8\n" * 1_000_000, compresslevel=1))
    monkeypatch.setattr(text_table, "_SMALL", 1_000_000)
    taken = []

    def watched(path: Path, **options: Any) -> TextSource:  # noqa: ANN401 - those of `open_text`
        taken.append(open_text(path, **options))
        return taken[-1]

    monkeypatch.setattr(text_table, "open_text", watched)
    assert describe(path).topics[0].count is None
    assert 1_000_000 < max(source.passed for source in taken) < 12_000_000


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("turned", [False, True])
def test_heads_of_arrays_are_those_of_the_whole(order: str, *, turned: bool, tmp_path: Path) -> None:
    """Along the longest axis, whichever it is and however it lies; the rest is zero."""
    matrix = np.asarray(TRUTH.all.T if turned else TRUTH.all, order=order)  # type: ignore[call-overload]
    np.savez_compressed(tmp_path / "log.npz", m=matrix, t=TIMES, cube=np.ones((2, 700, 3)), one=np.float64(7))
    heads = npz_arrays(tmp_path / "log.npz", limit=1 << 40, heads_above=0)
    along = (slice(None), slice(400)) if turned else (slice(400), slice(None))
    assert np.array_equal(heads["m"][along], matrix[along])
    assert not heads["m"].T[:, 400:].any() if not turned else not heads["m"][:, 400:].any()
    assert np.array_equal(heads["t"][:400], TIMES[:400])
    assert heads["cube"].sum() == 2 * 400 * 3
    assert heads["one"] == 7
    whole = npz_arrays(tmp_path / "log.npz", limit=1 << 40, heads_above=1 << 40)
    assert np.array_equal(whole["m"], matrix)


def test_arrays_above_the_limit_lie_in_temporary_files(tmp_path: Path) -> None:
    """And are the same; so are the samples of a recording."""
    np.savez_compressed(tmp_path / "log.npz", **arrays())  # type: ignore[arg-type]
    held, mapped = (npz_arrays(tmp_path / "log.npz", limit=limit) for limit in (1 << 40, 1000))
    for name, array in arrays().items():
        assert np.array_equal(held[name], array)
        assert np.array_equal(mapped[name], array)
        assert held[name].flags.writeable
        assert not mapped[name].flags.owndata
    recording = read(tmp_path / "log.npz", memory_limit=1000)
    assert np.array_equal(np.array([series.samples for series in recording.series]).T, TRUTH.all)


def test_a_member_that_claims_too_much_is_refused(tmp_path: Path) -> None:
    """Before memory is taken for it."""
    path = tmp_path / "log.npz"
    with zipfile.ZipFile(path, "w") as archive:
        header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
        head = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
        archive.writestr("gx.npy", head + bytes(80))
    with pytest.raises(ReadError, match=r"gx\.npy declares 8000000000000 bytes and contains 80"):
        read(path)


@pytest.mark.parametrize("kind", ["npz", "npy", "parquet"])
def test_typed_tables_are_described_by_their_heads(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows are counted by the headers; rate, sensors and units are those of the first."""
    path = tmp_path / f"log.{kind}"
    if kind == "npz":
        np.savez_compressed(path, **arrays())  # type: ignore[arg-type]
    elif kind == "npy":
        record = np.zeros(3000, dtype=[(name, "f8") for name in NAMES])
        for name, values in arrays().items():
            record[name] = values
        np.save(path, record)
    else:
        import polars as pl

        pl.DataFrame(arrays()).write_parquet(path)
    whole = describe(path)
    monkeypatch.setattr(typed_table, "_SMALL", 1000)
    part = describe(path)
    assert part.topics[0].count == whole.topics[0].count == 3000
    assert part.topics[0].rate_hz == pytest.approx(100)
    assert part.topics[0].sensors == whole.topics[0].sensors
    assert (part.duration_s, part.unpacked_bytes) == (None, 8 * 7 * 3000)


def test_info_reads_no_samples_of_what_unpacks_to_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says so, and --gaps does."""
    np.savez_compressed(tmp_path / "log.npz", **arrays())  # type: ignore[arg-type]
    assert "no gaps" in run("info", "log.npz", cwd=tmp_path).stdout
    monkeypatch.setattr("imucal.cli.info._SMALL", 150_000)
    monkeypatch.setattr(typed_table, "_SMALL", 150_000)
    done = run("info", "log.npz", cwd=tmp_path)
    assert "Gaps were not checked in a large log; --gaps reads all samples." in done.stdout
    assert "no gaps" in run("info", "--gaps", "log.npz", cwd=tmp_path).stdout
    listed = json.loads(run("info", "--json", "log.npz", cwd=tmp_path).stdout)
    assert listed["logs"][0]["unpacked_bytes"] == 8 * 7 * 3000


@pytest.mark.parametrize("packed", [True, False])
def test_a_matlab_file_that_is_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, packed: bool
) -> None:
    """Before it is unpacked, as it is read whole; each thing that the message says to do works."""
    import scipy.io

    path = tmp_path / "log.mat"
    scipy.io.savemat(path, arrays(), do_compression=packed)
    assert path.stat().st_size < 8 * 7 * 3000 + 1000
    monkeypatch.setenv("IMUCAL_MEMORY", str(4 * 8 * 7 * 3000))
    with pytest.raises(ReadError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: its arrays unpack to more than 0.168 MB, and a MAT file is read as a whole; expected at "
        "most a quarter of the memory for one step; save them as NPZ or CSV, or set IMUCAL_MEMORY to four "
        "times their size"
    )
    done = run("info", "log.mat", cwd=tmp_path)
    assert done.returncode == 3
    assert "log.mat: its arrays unpack to more than 0.168 MB" in done.stderr
    monkeypatch.setenv("IMUCAL_MEMORY", str(4 * (8 * 7 * 3000 + 1000)))
    assert read(path).series[0].n == 3000


def test_what_a_matlab_file_unpacks_to(tmp_path: Path) -> None:
    """Counted without being kept; a damaged or cut stream as far as it goes."""
    import scipy.io

    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"a": np.zeros(100_000), "b": np.zeros(100_000)}, do_compression=True)
    whole = 2 * (800_000 + 56)
    assert unpacks_to_more(path, whole - 1)
    assert not unpacks_to_more(path, whole)
    # A file of few bytes can't hold so much.
    assert not unpacks_to_more(path, path.stat().st_size * MOST_GROWTH)
    data = path.read_bytes()
    path.write_bytes(data[:-300])
    assert unpacks_to_more(path, 800_056)
    assert not unpacks_to_more(path, whole - 1)
    path.write_bytes(data[:128] + data[128:136] + bytes(len(data) - 136))
    assert not unpacks_to_more(path, 1)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_bomb_takes_little_memory(tmp_path: Path) -> None:
    """A tenth of a megabyte that unpacks to 96 MB is described in the memory of an empty program."""
    path = tmp_path / "log.npz"
    np.savez_compressed(path, gyro=np.zeros((4_000_000, 3)))
    code = (
        "import sys; from imucal.readers import describe; describe(sys.argv[1])\n"
        "print(next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')))"
    )
    done = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
    )
    assert path.stat().st_size < 300_000
    assert int(done.stdout) < 150_000

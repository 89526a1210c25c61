"""Tests of the store of a fleet: damaged and unfinished lines, rows that count, labels, and full disks."""

import errno
import io
import math
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.errors import ReadError, StoreError, WriteError
from imucal.fleet.store import AskedLog, LogRow, RunFile, is_fleet, read_store

SETTINGS: Mapping[str, object] = {"model": "N", "level": 0.95}
#: Number of changed bits in the test of damage; each takes 1 ms.
FLIPS = 200


def log(name: str, **more: Any) -> LogRow:  # noqa: ANN401 - values of any column
    """Return the row of a successful log."""
    row = {"key": f"key-{name}", "path": f"{name}.mcap", "status": "ok", "finished": 1.0, "unit": None}
    return {**row, "terms": [{"term": "N", "value": 1e-4}], **more}


def asked(name: str, *, copy_of: str | None = None, **labels: str | float) -> AskedLog:
    """Return a requested log."""
    return AskedLog(path=f"{name}.mcap", labels=labels, reading={"rate_hz": 100.0}, copy_of=copy_of)


def add(folder: Path, *rows: LogRow, logs: Iterable[AskedLog] = (), damaged: Sequence[str] = ()) -> Path:
    """Add a run with some rows to a store; return its file."""
    with RunFile(folder, SETTINGS, logs, damaged) as file:
        for row in rows:
            file.add(row)
    return file.path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return the name of a store that does not exist yet."""
    return tmp_path / "above" / "fleet"


def test_all_rows_of_all_runs_are_read_back(folder: Path) -> None:
    """Two runs write at once. The newest request of a log counts."""
    one = RunFile(folder, SETTINGS, [asked("a", unit="1"), asked("b")])
    with one, RunFile(folder, SETTINGS, [asked("a", unit="2"), asked("c", copy_of="b.mcap")]) as other:
        for file, name in ((one, "b"), (other, "d"), (one, "a")):
            file.add(log(name))
    stored = read_store(folder)
    assert (stored.settings, stored.damaged) == (SETTINGS, ())
    assert stored.rows == (log("b"), log("a"), log("d"))
    assert [*stored.asked.values()] == [asked("a", unit="2"), asked("b"), asked("c", copy_of="b.mcap")]
    assert [row["path"] for row in stored.logs()] == ["a.mcap", "b.mcap", "d.mcap"]
    stored.refuse_damage()


def test_any_name_and_number_can_be_stored(folder: Path) -> None:
    """Names of files need not be UTF-8; JSON has no infinite numbers."""
    name = os.fsdecode(b"\xff\xfe/caf\xe9\n \xe2\x80\xa8")
    add(folder, log(name, values=[math.nan, math.inf, 0.1]), logs=[asked(name)])
    stored = read_store(folder)
    assert list(stored.asked) == [f"{name}.mcap"]
    assert stored.rows == (log(name, values=[None, None, 0.1]),)


def test_every_changed_bit_is_noticed(folder: Path) -> None:
    """A command reports the line, and no number and no request is ever another one."""
    add(folder, log("a"), log("b"), logs=[asked("a", unit="1")])
    add(folder, log("c"), logs=[asked("c", unit="2")])
    whole = read_store(folder)
    files = sorted(folder.iterdir())
    rng = np.random.default_rng(8401)
    for _ in range(FLIPS):
        file = files[rng.integers(len(files))]
        before = file.read_bytes()
        data = bytearray(before)
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        file.write_bytes(data)
        stored = read_store(folder)
        file.write_bytes(before)
        assert {line.partition(":")[0] for line in stored.damaged} == {file.name}
        assert all(row in whole.rows for row in stored.rows)
        assert stored.asked.items() <= whole.asked.items()
        with pytest.raises(StoreError, match=r"run-.*\.fleet:\d+: is damaged, and does not count"):
            stored.refuse_damage()


def test_a_store_without_an_undamaged_line_is_refused(folder: Path) -> None:
    """Its model is unknown."""
    file = add(folder)
    for data, problem in ((b"x" + file.read_bytes(), "has no undamaged line of 1"), (b"", "is empty")):
        file.write_bytes(data)
        with pytest.raises(StoreError, match=f"{problem}; start the fleet again with --fresh"):
            read_store(folder)


@pytest.mark.parametrize("keep", [1, 30, -2, -1])
def test_the_torn_line_of_a_killed_run_does_not_count(folder: Path, keep: int) -> None:
    """The other lines count, and so does a line of which only the end is missing."""
    file = add(folder, log("a"), log("b"))
    *lines, last = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join([*lines, last[:keep]]))
    stored = read_store(folder)
    whole = (log("a"), log("b")), ()
    assert (stored.rows, stored.damaged) == (whole if keep == -1 else ((log("a"),), (f"{file.name}:3",)))


def test_a_line_that_is_being_written_gets_time(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A report during a run finds no damage."""
    file = add(folder, log("a"), log("b"))
    whole = file.read_bytes()
    file.write_bytes(whole[:-40])
    monkeypatch.setattr("time.sleep", lambda _: file.write_bytes(whole))
    stored = read_store(folder)
    assert (stored.rows, stored.damaged) == ((log("a"), log("b")), ())


def test_damage_that_a_later_run_knows_is_repaired(folder: Path) -> None:
    """The later run repeats its logs; another damaged line is new."""
    file = add(folder, log("a"), log("b"))
    file.write_bytes(file.read_bytes().replace(b"key-b", b"key-x"))
    damaged = read_store(folder).damaged
    assert damaged == (f"{file.name}:3",)
    add(folder, log("b"), damaged=damaged)
    stored = read_store(folder)
    assert (stored.rows, stored.damaged) == ((log("a"), log("b")), ())
    file.write_bytes(file.read_bytes().replace(b"key-a", b"key-x"))
    assert read_store(folder).damaged == (f"{file.name}:2",)


def test_a_content_and_a_path_count_once(folder: Path) -> None:
    """The newest success of a content counts, otherwise its newest failure; and a path's newest content."""
    add(folder, log("a", finished=3.0), log("a", finished=2.0), log("a", finished=4.0, status="memory"))
    add(folder, log("b", finished=2.0, status="crash"), log("b", status="memory"))
    add(folder, log("c", finished=2.0, key="key-new", status="unreadable"), log("c"))
    found = [(row["key"], row["finished"], row["status"]) for row in read_store(folder).logs()]
    assert found == [("key-a", 3.0, "ok"), ("key-b", 2.0, "crash"), ("key-new", 2.0, "unreadable")]


def test_the_newest_labels_count(folder: Path) -> None:
    """Labels that only the log has stay, and no label replaces a result. A moved log has its new labels."""
    add(folder, log("a", unit="old", started="2026-01-02"), logs=[asked("a", unit="7", status="odd")])
    assert read_store(folder).logs() == [log("a", unit="7", started="2026-01-02")]
    add(
        folder,
        log("b"),
        logs=[asked("a", unit="8", temperature_c=2.5), asked("new", unit="9", copy_of="b.mcap")],
    )
    labelled = log("a", unit="8", started="2026-01-02", temperature_c=2.5)
    assert read_store(folder).logs() == [labelled, log("b", unit="9")]


@pytest.mark.parametrize("settings", [{"model": "N + K", "level": 0.95}, {"model": "N", "level": 0.9}])
def test_other_settings_are_refused(folder: Path, settings: Mapping[str, object]) -> None:
    """Fits of two models are no population."""
    add(folder, log("a"))
    with (
        RunFile(folder, settings),
        pytest.raises(StoreError, match=r"has fits with .*, other files .*; move"),
    ):
        read_store(folder)


def test_a_folder_without_a_fleet_is_rejected(tmp_path: Path) -> None:
    """The folder is not changed."""
    for place, message in (("none", "no such folder"), (".", "no fleet in this folder")):
        with pytest.raises(ReadError, match=message):
            read_store(tmp_path / place)
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(WriteError, match=r"contains thesis\.tex but no imucal fleet; nothing was changed"):
        RunFile(tmp_path, SETTINGS)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(WriteError, match=r"thesis\.tex.*can't be written: .*; free some space or choose"):
        RunFile(tmp_path / "thesis.tex" / "fleet", SETTINGS)


def test_a_file_that_cannot_be_read_is_an_error(folder: Path) -> None:
    """It may have results."""
    (folder / "run-9.fleet").mkdir(parents=True)
    with pytest.raises(StoreError, match=r"run-9\.fleet: can't be read: Is a directory; make it readable"):
        read_store(folder)


class FullDisk(io.FileIO):
    """A file with little room: a write stores what fits, and the next one fails."""

    #: Bytes; the first line and one log need less, two logs more.
    room = 450

    def write(self, data: Any, /) -> int:  # noqa: ANN401 - any buffer
        """Write as many bytes as fit."""
        if (left := self.room - self.tell()) <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data[:left])


def test_a_full_disk_leaves_no_torn_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The log is not done, and a later line is whole. A run that cannot begin leaves no file."""
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", lambda path, mode, **_: FullDisk(path, mode))
        file = RunFile(folder, SETTINGS)
        patch.setattr(FullDisk, "room", 10)
        with pytest.raises(WriteError, match="No space left on device"):
            RunFile(folder.parent / "other", SETTINGS)
    assert not is_fleet(folder.parent / "other")
    with file:
        file.add(log("a"))
        whole = file.path.read_bytes()
        with pytest.raises(WriteError, match="can't be written: No space left on device; free some") as error:
            file.add(log("b"))
        assert (error.value.exit_code, file.path.read_bytes()) == (5, whole)
        monkeypatch.setattr(FullDisk, "room", 10_000)
        file.add(log("c"))
    stored = read_store(folder)
    assert (stored.rows, stored.damaged) == ((log("a"), log("c")), ())


def test_a_deleted_file_is_noticed(folder: Path) -> None:
    """Otherwise a run would write for hours into a file without a name."""
    with RunFile(folder, SETTINGS) as file:
        file.add(log("a"))
        shutil.rmtree(folder)
        with pytest.raises(WriteError, match="can't be written: No such file or directory"):
            file.add(log("b"))


def test_a_fresh_run_removes_the_others(folder: Path) -> None:
    """The reports of their logs go too; other files stay."""
    add(folder, log("a", report="reports/key-a", files={"report.json": b"{}"}))
    (folder / "fleet.html").write_text("page")
    with RunFile(folder, SETTINGS) as file:
        assert (folder / "reports/key-a/report.json").read_bytes() == b"{}"
        file.forget_others()
        file.add(log("b"))
    assert sorted(path.name for path in folder.iterdir()) == ["fleet.html", file.path.name]
    assert read_store(folder).rows == (log("b"),)

"""The report folder is complete or unchanged after any error."""

import errno
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from imucal.errors import ReadError, WriteError
from imucal.report import json_file, writer
from imucal.report.writer import write_report
from tests.report.synthetic import consumer_report, small_report

_FILES = ["gyro_x.json", "report.json", "signal.json"]


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """Return a report folder of an earlier version, with a stale picture and a note of the user."""
    out = tmp_path / "out"
    write_report(replace(small_report(), version="0.0.1"), out, formats=(), html=False)
    (out / "accel_z.png").write_bytes(b"stale")
    (out / "notes.txt").write_text("bench 3", encoding="utf-8")
    return out


@pytest.fixture
def weak_user() -> Iterator[Path]:
    """Yield a folder without write permission; if the user is root, drop root's rights for the test."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o555)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield folder
    finally:
        if root:
            os.seteuid(0)
        shutil.rmtree(folder)


def test_the_folder_contains_all_files_of_a_report(tmp_path: Path) -> None:
    """A report has a JSON and a picture per axis, an overview per sensor and a page; report.json is first."""
    report = consumer_report()
    report = replace(report, axes=report.axes[2:4])
    files = write_report(report, tmp_path / "deep" / "out")
    assert [path.name for path in files] == [
        "report.json",
        "report.html",
        "signal.json",
        "gyro_z.json",
        "gyro_z.png",
        "accel_x.json",
        "accel_x.png",
        "gyro.png",
        "accel.png",
    ]
    assert sorted(path.name for path in files) == _names(tmp_path / "deep" / "out")
    assert all(path.stat().st_size > 1000 for path in files)
    assert _names(tmp_path / "deep") == ["out"]
    assert json_file.load(tmp_path / "deep" / "out").axes[0].name == "gyro_z"
    assert json.loads(files[3].read_bytes())["name"] == "gyro_z"


@pytest.mark.parametrize(("form", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF"), ("png", b"\x89PNG")])
def test_pictures_are_written_in_every_format(tmp_path: Path, form: str, start: bytes) -> None:
    files = write_report(small_report(), tmp_path / "out", formats=(form,), html=False)
    pictures = [f"gyro_x.{form}", f"gyro.{form}"]
    assert [path.name for path in files] == ["report.json", "signal.json", "gyro_x.json", *pictures]
    assert all(path.read_bytes().startswith(start) for path in files[3:])


def test_the_same_report_gives_the_same_bytes(tmp_path: Path) -> None:
    """Files contain no date and no random name, so that runs can be compared with diff."""
    one = write_report(small_report(), tmp_path / "one")
    other = write_report(small_report(), tmp_path / "other")
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]


def test_files_have_the_permissions_of_the_umask(tmp_path: Path) -> None:
    """The scratch folder is private, the report is not."""
    out = write_report(small_report(), tmp_path / "out", formats=(), html=False)[0].parent
    plain = tmp_path / "plain"
    plain.mkdir()
    assert out.stat().st_mode == plain.stat().st_mode


def test_an_old_report_is_replaced_and_other_files_are_kept(old: Path) -> None:
    """Stale pictures are removed, and notes of the user are kept."""
    write_report(small_report(), old, formats=(), html=False)
    assert _names(old) == ["gyro_x.json", "notes.txt", "report.json", "signal.json"]
    assert json_file.load(old).version == "0.1.0"


def test_an_empty_folder_is_used(tmp_path: Path) -> None:
    """An empty folder can be a mounted volume with a read-only parent."""
    write_report(small_report(), tmp_path, formats=(), html=False)
    assert _names(tmp_path) == _FILES


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            ["thesis.tex"],
            "{out}: contains thesis.tex but no imucal report; nothing was changed; choose another folder",
        ),
        (
            ["a", "b", "c", "d"],
            "{out}: contains a, b, c, … but no imucal report; nothing was changed; choose another folder",
        ),
        (
            ["gyro_x.png"],
            "{out}: contains gyro_x.png but no imucal report; nothing was changed; choose another folder",
        ),
        (
            ["report.json"],
            "{out}: contains report.json but no imucal report; nothing was changed; choose another folder",
        ),
    ],
)
def test_a_foreign_folder_is_not_changed(tmp_path: Path, names: list[str], message: str) -> None:
    """Only a report.json of imucal identifies a report folder, not the names of the files."""
    for name in names:
        (tmp_path / name).write_text('{"schema": "other"}', encoding="utf-8")
    with pytest.raises(WriteError) as caught:
        write_report(small_report(), tmp_path, formats=(), html=False)
    assert str(caught.value) == message.format(out=tmp_path)
    assert _names(tmp_path) == sorted(names)


def test_a_file_with_the_name_of_the_folder_is_not_changed(tmp_path: Path) -> None:
    """The error explains what to do."""
    out = tmp_path / "out"
    out.write_text("mine", encoding="utf-8")
    with pytest.raises(WriteError) as caught:
        write_report(small_report(), out)
    assert str(caught.value) == (
        f"{out}: is a file, expected a folder or nothing; move it away or choose another folder"
    )
    assert out.read_text(encoding="utf-8") == "mine"


def test_a_folder_with_the_name_of_a_file_stops_the_write(old: Path) -> None:
    """The obstacle is found before any file is replaced."""
    (old / "gyro_x.png").mkdir()
    before = _contents(old)
    with pytest.raises(WriteError, match=re.escape(f"{old / 'gyro_x.png'}: is a folder, expected a file")):
        write_report(small_report(), old, html=False)
    assert _contents(old) == before


def test_an_unknown_picture_format_is_an_error(tmp_path: Path) -> None:
    """The error is raised before anything is written."""
    with pytest.raises(ValueError, match="'gif'"):
        write_report(small_report(), tmp_path / "out", formats=("gif",))
    assert _names(tmp_path) == []


def test_a_read_only_folder_is_an_error_with_advice(weak_user: Path) -> None:
    """The exit code is 5, and nothing is left behind."""
    with pytest.raises(WriteError) as caught:
        write_report(small_report(), weak_user / "out", formats=(), html=False)
    assert str(caught.value) == (
        f"{weak_user / 'out'}: the report can't be written: Permission denied; nothing was changed; "
        "choose a folder you may write to"
    )
    assert caught.value.exit_code == 5
    assert _names(weak_user) == []


@pytest.mark.parametrize("failing", range(2))
def test_a_full_disk_leaves_the_old_report(old: Path, monkeypatch: pytest.MonkeyPatch, failing: int) -> None:
    """The disk is full at the first or at the second file."""
    before = _contents(old)
    calls = iter(range(100))

    def fsync(_: int) -> None:
        if next(calls) == failing:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(WriteError) as caught:
        write_report(small_report(), old, formats=(), html=False)
    assert str(caught.value) == (
        f"{old}: the report can't be written: No space left on device; nothing was changed; free some space"
    )
    assert _contents(old) == before


def test_an_incomplete_write_leaves_the_old_report(old: Path) -> None:
    """The kernel cuts the file at a size limit, and the incomplete file is removed."""
    before = _contents(old)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(WriteError, match="File too large"):
            write_report(small_report(), old, formats=(), html=False)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert _contents(old) == before


@pytest.mark.parametrize("existing", [False, True])
def test_ctrl_c_leaves_the_old_report(old: Path, monkeypatch: pytest.MonkeyPatch, *, existing: bool) -> None:
    """KeyboardInterrupt is raised, and no scratch folder is left."""
    out = old if existing else old.parent / "new"
    before = _contents(old.parent)

    def interrupted(*_: object) -> object:
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "axis_document", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_report(small_report(), out, formats=(), html=False)
    assert _contents(old.parent) == before


@pytest.mark.parametrize("moved", [0, 1, 3, 4])
def test_a_kill_between_files_leaves_only_complete_files(old: Path, moved: int) -> None:
    """No handler runs on SIGKILL.

    The report.json is old, new, or marks the folder as incomplete, and the next run succeeds.
    """
    before = _contents(old)
    _run_and_die(old, moved)
    content = (old / "gyro_x.json").read_bytes()
    assert json.loads(content)["version"] == "0.1.0" or content == before[f"{old.name}/gyro_x.json"]
    report = json.loads((old / "report.json").read_bytes())
    if moved in {1, 3}:
        assert report["incomplete"] == "its files were being replaced; write the report again"
        with pytest.raises(ReadError, match="the key 'version'"):
            json_file.load(old)
    else:
        assert report["version"] == ("0.1.0" if moved else "0.0.1")
        assert json_file.load(old).axes
    assert [p.name for p in old.iterdir() if p.name.startswith(".imucal-")]
    _age_scratch(old)
    write_report(small_report(), old, formats=(), html=False)
    assert _names(old) == ["gyro_x.json", "notes.txt", "report.json", "signal.json"]


@pytest.mark.parametrize("existing", [False, True])
def test_simultaneous_runs_leave_one_consistent_report(tmp_path: Path, *, existing: bool) -> None:
    """All files are from the same run, whichever was last."""
    out = tmp_path / "out"
    if existing:
        write_report(small_report(), out, formats=(), html=False)
    versions = [f"0.0.{i}" for i in range(6)]
    reports = [replace(consumer_report(), version=version) for version in versions]
    with ThreadPoolExecutor(len(reports)) as pool:
        done = [pool.submit(write_report, one, out, formats=(), html=False) for one in reports]
    assert {len(one.result()) for one in done} == {8}
    found = {json.loads(path.read_bytes())["version"] for path in out.iterdir()}
    assert len(found) == 1
    assert found <= set(versions)
    assert _names(tmp_path) == ["out"]


def test_a_kill_during_the_first_report_leaves_no_folder(tmp_path: Path) -> None:
    """A new folder appears in one step, so that half a report can't be mistaken for a complete one."""
    out = tmp_path / "out"
    _run_and_die(out, 0)
    assert not out.exists()
    _age_scratch(tmp_path)
    write_report(small_report(), out, formats=(), html=False)
    assert _names(tmp_path) == ["out"]


def test_a_scratch_folder_in_use_is_not_removed(tmp_path: Path) -> None:
    """Simultaneous runs must not remove each other's files."""
    scratch = tmp_path / ".imucal-0123.tmp"
    scratch.mkdir()
    write_report(small_report(), tmp_path / "out", formats=(), html=False)
    assert scratch.is_dir()


def test_a_failed_move_reports_the_remaining_files(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first move, the error must no longer claim that nothing changed."""
    move = Path.replace

    def failing(self: Path, target: Path) -> Path:
        if self.name == "signal.json":
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return move(self, target)

    monkeypatch.setattr(Path, "replace", failing)
    with pytest.raises(WriteError) as caught:
        write_report(small_report(), old, formats=(), html=False)
    assert str(caught.value) == (
        f"{old}: only 0 of 3 files were replaced: Input/output error; the report is incomplete; "
        "write it again"
    )


def _run_and_die(out: Path, moved: int) -> None:
    """Write a report in another process that kills itself after `moved` files were moved."""
    code = f"""
        import os, signal
        from pathlib import Path
        from imucal.report.writer import write_report
        from tests.report.synthetic import small_report
        move, count = Path.replace, iter(range(100))
        def dying(self, *target):
            if next(count) == {moved}:
                os.kill(os.getpid(), signal.SIGKILL)
            return move(self, *target)
        Path.replace = dying
        Path.unlink = Path.rename = dying
        write_report(small_report(), Path({str(out)!r}), formats=(), html=False)
    """
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], cwd=root, check=False)  # noqa: S603 - our own code
    assert done.returncode == -signal.SIGKILL


def _age_scratch(folder: Path) -> None:
    for path in folder.glob(".imucal-*.tmp"):
        os.utime(path, (0, 0))


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _contents(folder: Path) -> dict[str, bytes]:
    base = folder.parent
    return {str(p.relative_to(base)): p.read_bytes() for p in folder.rglob("*") if p.is_file()} | {
        str(p.relative_to(base)): b"" for p in folder.rglob("*") if p.is_dir()
    }

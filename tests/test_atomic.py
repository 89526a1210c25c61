"""A file is written whole or not at all; so is a folder of results."""

import errno
import json
import os
import re
from pathlib import Path

import pytest

from imucal.atomic import OutFolder, replacing
from imucal.errors import WriteError


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    """Ctrl-C in the middle loses nothing."""
    target = tmp_path / "report.json"
    target.write_text("old", encoding="utf-8")

    def interrupted() -> None:
        with replacing(target) as scratch:
            scratch.write_text("half", encoding="utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert target.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_complete_write_takes_the_place_of_the_old_file(tmp_path: Path) -> None:
    """The new file is there, the scratch folder is not."""
    target = tmp_path / "report.json"
    target.write_text("old", encoding="utf-8")
    with replacing(target) as scratch:
        scratch.write_text("new", encoding="utf-8")
    assert target.read_text(encoding="utf-8") == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_a_missing_folder_is_a_write_error(tmp_path: Path) -> None:
    """The message says where and what to do."""
    target = tmp_path / "nowhere" / "a.json"
    with pytest.raises(WriteError) as caught, replacing(target):
        pass
    assert str(caught.value) == f"{target}: can't be written: No such file or directory; choose another place"


def test_somebody_elses_file_is_not_replaced(tmp_path: Path) -> None:
    """One of our own is."""
    target = tmp_path / "imu.yaml"
    target.write_text("# tuned by hand\n", encoding="utf-8")
    with pytest.raises(WriteError) as caught, replacing(target, ours="written by imucal"):
        pass
    expected = f"{target}: exists and was not written by imucal; move it away, or choose another place"
    assert str(caught.value) == expected
    target.write_text("# written by imucal 0.1\n", encoding="utf-8")
    with replacing(target, ours="written by imucal") as scratch:
        scratch.write_text("new", encoding="utf-8")
    assert target.read_text(encoding="utf-8") == "new"


def test_a_device_is_not_replaced() -> None:
    """Moving a file onto it would remove it."""
    with (
        pytest.raises(WriteError, match="/dev/null: not a regular file; choose another place"),
        replacing(Path("/dev/null")),
    ):
        pass
    assert not Path("/dev/null").is_file()


def _folder(path: Path, *, shared: bool) -> OutFolder:
    own = re.compile(r"[a-c]\.txt")
    return OutFolder(
        path=path, what="imucal test", document="d.json", schema="imucal/test/1", own=own, shared=shared
    )


_DOCUMENT = json.dumps({"schema": "imucal/test/1"}).encode()


@pytest.mark.parametrize("shared", [False, True])
def test_a_full_disk_leaves_a_folder_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, shared: bool
) -> None:
    """A folder that was missing stays missing."""
    folder = _folder(tmp_path / "out", shared=shared)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for old in ({}, {"d.json": _DOCUMENT, "a.txt": b"old"}):
        if old:
            folder.write(old)
        with monkeypatch.context() as context:
            context.setattr(os, "fsync", full)
            with pytest.raises(WriteError) as caught:
                folder.write({"d.json": _DOCUMENT, "b.txt": b"new"})
        assert str(caught.value) == (
            f"{folder.path}: the test can't be written: No space left on device; nothing was changed; "
            "free some space"
        )
        assert folder.path.exists() == bool(old)
        assert {path.name: path.read_bytes() for path in tmp_path.glob("out/*")} == old


@pytest.mark.parametrize("shared", [False, True])
def test_a_folder_shows_that_its_files_are_being_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, shared: bool
) -> None:
    """The next write completes it; obsolete files go and foreign ones stay."""
    folder = _folder(tmp_path, shared=shared)
    folder.write({"d.json": _DOCUMENT, "a.txt": b"old", "b.txt": b"old"})
    (tmp_path / "mine.txt").write_text("mine")
    move = Path.replace

    def interrupted(self: Path, target: Path) -> Path:
        if self.name == "c.txt":
            raise KeyboardInterrupt
        return move(self, target)

    with monkeypatch.context() as context:
        context.setattr(Path, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            folder.write({"d.json": _DOCUMENT, "b.txt": b"new", "c.txt": b"new"})
    if shared:
        assert not (tmp_path / "d.json").exists()
    else:
        assert json.loads((tmp_path / "d.json").read_bytes()) == {
            "schema": "imucal/test/1",
            "incomplete": "its files were being replaced; write the test again",
        }
    folder.write({"d.json": _DOCUMENT, "b.txt": b"new", "c.txt": b"new"})
    names = {path.name for path in tmp_path.iterdir()} - {".lock"}
    assert names == {"d.json", "b.txt", "c.txt", "mine.txt"}
    assert (tmp_path / "d.json").read_bytes() == _DOCUMENT


def test_only_a_shared_folder_may_contain_foreign_files_alone(tmp_path: Path) -> None:
    """A document of another schema is foreign."""
    (tmp_path / "d.json").write_text('{"schema": "imucal/tests/1"}')
    with pytest.raises(WriteError, match=r"contains d\.json but no imucal test; nothing was changed; choose"):
        _folder(tmp_path, shared=False).check()
    _folder(tmp_path, shared=True).check()

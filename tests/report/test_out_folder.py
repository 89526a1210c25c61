"""A folder of results is complete, unchanged, or marked as incomplete."""

import errno
import json
import os
import re
from pathlib import Path

import pytest

from imucal.errors import WriteError
from imucal.report.out_folder import OutFolder


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


def test_an_error_between_two_files_changes_nothing(tmp_path: Path) -> None:
    """The error of the block is raised as it is, and the scratch folder is removed."""
    folder = _folder(tmp_path, shared=False)
    folder.write({"d.json": _DOCUMENT, "a.txt": b"old"})

    def fill() -> None:
        with folder.filling() as files:
            assert files.add("a.txt", b"new") == tmp_path / "a.txt"
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fill()
    contents = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert contents == {"d.json": _DOCUMENT, "a.txt": b"old"}


def test_only_a_shared_folder_may_contain_foreign_files_alone(tmp_path: Path) -> None:
    """A document of another schema is foreign."""
    (tmp_path / "d.json").write_text('{"schema": "imucal/tests/1"}')
    with pytest.raises(WriteError, match=r"contains d\.json but no imucal test"):
        _folder(tmp_path, shared=False).check()
    _folder(tmp_path, shared=True).check()

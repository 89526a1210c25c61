"""Locks between processes: files, folders, and file systems without locks."""

import errno
import fcntl
import os
from pathlib import Path

import pytest

from imucal.locks import locked


def test_a_removed_lock_file_is_not_a_lock(tmp_path: Path) -> None:
    """A waiting process takes the new lock file."""
    path = tmp_path / "a.lock"
    with locked(path) as first:
        assert first
        with locked(path, wait=False) as second:
            assert not second
        path.unlink()
        with locked(path, wait=False) as new:
            assert new


def test_a_folder_is_its_own_lock(tmp_path: Path) -> None:
    """No file is created in it."""
    with locked(tmp_path), locked(tmp_path, wait=False) as second:
        assert not second
    assert not list(tmp_path.iterdir())


def test_without_locks_of_the_file_system_each_is_acquired(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """NFS without a lock server refuses them with ENOLCK."""

    def refuse(*_: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with locked(tmp_path / "a.lock") as first, locked(tmp_path / "a.lock", wait=False) as second:
        assert first
        assert second

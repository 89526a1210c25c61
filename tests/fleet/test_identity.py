"""Tests of the identity of logs: size and both ends of their files."""

import os
from pathlib import Path

import pytest

from imucal.fleet.identity import LogIdentity, identities_of, identity_of

#: More bytes than both ends together.
LONG = 1 << 18


def identity(path: Path, data: bytes) -> LogIdentity | None:
    """Return the identity of a new file."""
    path.write_bytes(data)
    return identity_of(str(path))


@pytest.mark.parametrize(
    ("place", "equal"), [(0, False), (65_535, False), (LONG // 2, True), (LONG - 65_536, False), (-1, False)]
)
def test_size_and_both_ends_are_compared(tmp_path: Path, place: int, *, equal: bool) -> None:
    """A change in the middle that keeps the size is not seen, as documented."""
    data = bytearray(LONG)
    whole = identity(tmp_path / "a", bytes(data))
    assert whole is not None
    assert whole.size == LONG
    assert identity(tmp_path / "longer", bytes(LONG + 1)) != whole
    data[place] = 1
    assert (identity(tmp_path / "b", bytes(data)) == whole) is equal


def test_a_large_log_is_not_read(tmp_path: Path) -> None:
    """Reading 1 TB would take an hour."""
    with (tmp_path / "log").open("wb") as file:
        file.truncate(1 << 40)
    found = identity_of(str(tmp_path / "log"))
    assert found is not None
    assert found.size == 1 << 40


def test_what_is_no_file_has_no_identity(tmp_path: Path) -> None:
    """Neither a pipe nor a device is opened: that might never end."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "log").write_bytes(b"x")
    names = {name: str(tmp_path / name) for name in ("pipe", "folder", "missing", "log")}
    assert list(identities_of({**names, "device": "/dev/ptmx"})) == ["log"]

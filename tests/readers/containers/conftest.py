"""Files of a few bytes."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from imucal.readers.files import LogFile

__all__ = ["held"]


@pytest.fixture
def held(tmp_path: Path) -> Iterator[Callable[..., LogFile]]:
    """Return what makes a file of some bytes, and opens it."""
    files: list[LogFile] = []

    def hold(*parts: bytes) -> LogFile:
        path = tmp_path / f"{len(files)}.log"
        path.write_bytes(b"".join(parts))
        files.append(LogFile(path))
        return files[-1]

    yield hold
    for file in files:
        file.close()

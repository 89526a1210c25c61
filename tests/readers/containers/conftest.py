"""Fixtures that write files of a few bytes."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from imucal.readers.containers.mcap import McapFile
from imucal.readers.files import LogFile

__all__ = ["held", "mcap_of"]


@pytest.fixture
def held(tmp_path: Path) -> Iterator[Callable[..., LogFile]]:
    """Return a function that writes bytes into a file and opens it."""
    files: list[LogFile] = []

    def hold(*parts: bytes) -> LogFile:
        path = tmp_path / f"{len(files)}.log"
        path.write_bytes(b"".join(parts))
        files.append(LogFile(path))
        return files[-1]

    yield hold
    for file in files:
        file.close()


@pytest.fixture
def mcap_of(held: Callable[..., LogFile]) -> Iterator[Callable[..., McapFile]]:
    """Return a function that writes bytes into a file and opens it as an MCAP file."""
    with ExitStack() as files:

        def open_mcap(*parts: bytes) -> McapFile:
            return files.enter_context(closing(McapFile(held(*parts).path)))

        yield open_mcap

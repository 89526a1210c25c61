"""Write files that are complete or unchanged after any failure."""

import os
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from imucal.errors import Fix, WriteError

#: Bytes that are searched for the mark of imucal.
_START = 4096
#: In the comment of every config file.
_OURS = "written by imucal "
#: An older scratch folder, in s, is left from a killed run.
_ABANDONED_S = 3600.0


@contextmanager
def replacing(path: Path, *, ours: str | None = None) -> Iterator[Path]:
    """Yield a scratch path to write to; on success this file replaces `path`.

    The scratch path has the same name, in a folder next to the target that is always removed, also after
    Ctrl-C. A file without the text `ours` near its start is not replaced; None replaces any. Raises
    WriteError if the file can't be written or must not be replaced.
    """
    _refuse_foreign(path, ours)
    # The name is known before the folder exists, so that Ctrl-C right after its creation removes it too.
    folder = path.parent / f".{path.name}.{secrets.token_hex(8)}"
    try:
        _make_scratch(folder, path)
        scratch = folder / path.name
        yield scratch
        if scratch.is_file():
            with scratch.open("rb+") as stream:
                os.fsync(stream.fileno())
        scratch.replace(path)
    except OSError as error:
        problem = f"can't be written: {error.strerror or error}"
        raise WriteError(problem, place=path, fix=Fix("free some space or choose another place")) from error
    finally:
        with suppress(OSError):
            shutil.rmtree(folder)


def _make_scratch(folder: Path, path: Path) -> None:
    try:
        folder.mkdir(mode=0o700)
    except OSError as error:
        problem = f"can't be written: {error.strerror or error}"
        raise WriteError(problem, place=path, fix=Fix("choose another place")) from error


def _refuse_foreign(path: Path, ours: str | None) -> None:
    """Raise WriteError if the path is a device or a file that imucal did not write."""
    if not path.exists() or path.is_dir():
        return
    if not path.is_file():
        raise WriteError("not a regular file", place=path, fix=Fix("choose another place"))
    if ours is None:
        return
    try:
        with path.open("rb") as stream:
            start = stream.read(_START)
    except OSError as error:
        problem = f"can't be read before it is replaced: {error.strerror or error}"
        raise WriteError(problem, place=path, fix=Fix("choose another place")) from error
    if ours.encode() not in start:
        problem = "exists and was not written by imucal"
        raise WriteError(problem, place=path, fix=Fix("move it away, or choose another place"))


def sweep(scratch: Iterable[Path]) -> None:
    """Remove scratch folders of killed runs."""
    for folder in scratch:
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > _ABANDONED_S:
                shutil.rmtree(folder)


def sync_folder(folder: Path) -> None:
    """Force a folder's entries to disk, if the operating system can."""
    with suppress(OSError, AttributeError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def make_folder(path: Path) -> None:
    """Create a folder unless it exists; raises WriteError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "it is a file" if path.is_file() else error.strerror or error
        problem = f"can't be created: {reason}"
        raise WriteError(problem, place=path, fix=Fix("choose another folder")) from error


def write_configs(texts: Mapping[str, str], path: Path, *, folder: bool = False) -> tuple[Path, ...]:
    """Write the texts of config files, by their names; return their paths.

    They go into the folder `path`, which is created if `folder`; a single one may go to the file `path`. If
    imucal did not write one of the files that would be replaced, nothing is written: a WriteError.
    """
    if folder:
        make_folder(path)
    files = [path / name if path.is_dir() else path for name in texts]
    for file in files:
        _refuse_foreign(file, _OURS)
    for file, text in zip(files, texts.values(), strict=True):
        with replacing(file, ours=_OURS) as scratch:
            scratch.write_text(text, encoding="utf-8", newline="\n")
    return tuple(files)

"""Write a file so that it is complete or unchanged, whatever fails."""

import os
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp

from imucal.errors import WriteError

#: How much of an existing file is searched for the words that make it ours, in bytes.
_START = 4096
#: Words in the comment of every config file.
_OURS = "written by imucal "
#: A scratch folder older than this, in s, was left by a run that was killed.
_ABANDONED_S = 3600.0


@contextmanager
def replacing(path: Path, *, ours: str | None = None) -> Iterator[Path]:
    """Yield a scratch path to write to; on success what was written there takes the place of `path`.

    The scratch path has the same name in a folder beside the target, which is removed whatever happens,
    Ctrl-C included; an existing file stays as it was until the new one is complete. An existing file
    without the words `ours` near its start is somebody's own and is not replaced; None replaces any. A
    WriteError says that the file can't be written, or that what is in its place is not to be replaced.
    """
    _refuse_foreign(path, ours)
    try:
        folder = Path(mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        msg = f"{path}: can't be written: {error.strerror or error}; choose another place"
        raise WriteError(msg) from error
    try:
        scratch = folder / path.name
        yield scratch
        if scratch.is_file():
            with scratch.open("rb+") as stream:
                os.fsync(stream.fileno())
        scratch.replace(path)
    except OSError as error:
        msg = f"{path}: can't be written: {error.strerror or error}; free some space or choose another place"
        raise WriteError(msg) from error
    finally:
        with suppress(OSError):
            shutil.rmtree(folder)


def _refuse_foreign(path: Path, ours: str | None) -> None:
    """Raise where something stands that must stay: a device, or a file of somebody else."""
    if not path.exists() or path.is_dir():
        return
    if not path.is_file():
        raise WriteError(f"{path}: not a regular file; choose another place")
    if ours is None:
        return
    try:
        with path.open("rb") as stream:
            start = stream.read(_START)
    except OSError as error:
        msg = f"{path}: can't be read before it is replaced: {error.strerror or error}; choose another place"
        raise WriteError(msg) from error
    if ours.encode() not in start:
        msg = f"{path}: exists and was not written by imucal; move it away, or choose another place"
        raise WriteError(msg)


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold the lock of a folder, or of a file that is made for it, where the file system has locks.

    Whoever else asks for it waits.
    """
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_CREAT, 0o666)
    try:
        with suppress(ImportError, OSError):
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def sweep(scratch: Iterable[Path]) -> None:
    """Remove those of some scratch folders that killed runs have left."""
    for folder in scratch:
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > _ABANDONED_S:
                shutil.rmtree(folder)


def sync_folder(folder: Path) -> None:
    """Force a folder's entries to disk, where the operating system can."""
    with suppress(OSError, AttributeError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def make_folder(path: Path) -> None:
    """Create a folder unless it exists; a WriteError if that is not possible."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "it is a file" if path.is_file() else error.strerror or error
        raise WriteError(f"{path}: can't be created: {reason}; choose another folder") from error


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

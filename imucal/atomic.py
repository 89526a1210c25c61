"""Writing a file so that it is whole or not there."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp

from imucal.errors import WriteError

__all__ = ["replacing"]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a scratch path to write to; on success what was written there takes the place of `path`.

    The scratch path has the same name in a folder beside the target, which is removed whatever
    happens, Ctrl-C included; an existing file stays as it was until the new one is complete.

    Raises
    ------
    WriteError
        If the file can't be written.
    """
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

"""Size and checksum of the files of a log, worked out beside what is done with it."""

import hashlib
import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from imucal.parallel import CHECKSUMS
from imucal.readers.containers.rosbag2_folder import natural
from imucal.readers.formats import STDIN
from imucal.recording import LogFileInfo
from imucal.resources import threads

#: Bytes hashed at once: large enough that other threads work meanwhile.
_BLOCK = 1 << 20


class Checksums:
    """The checksums of logs, from a thread that starts with the ``with`` block and is stopped by its end.

    With one thread allowed they are worked out when they are asked for.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self._files = [file for path in paths for file in _files_of(path)]
        self._found: list[LogFileInfo] = []
        self._stop = threading.Event()
        self._thread = (
            threading.Thread(target=self._work, name=CHECKSUMS, daemon=True) if threads() > 1 else None
        )

    def __enter__(self) -> Self:
        if self._thread is not None:
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def files(self) -> tuple[LogFileInfo, ...]:
        """Return path, size and checksum of every file; waits until they are known."""
        if self._thread is None:
            self._work()
        else:
            self._thread.join()
        return tuple(self._found)

    def _work(self) -> None:
        self._found = []
        for path in self._files:
            info = _checked(path, self._stop)
            if info is None:
                return
            self._found.append(info)


def _checked(path: Path, stop: threading.Event) -> LogFileInfo | None:
    """Return what is known of a file; None where nobody waits for it any more."""
    machine, size = hashlib.blake2b(), 0
    # The same memory for every block: new pages take longer than reading into them.
    block = memoryview(bytearray(_BLOCK))
    try:
        with path.open("rb", buffering=0) as file:
            while count := file.readinto(block):
                if stop.is_set():
                    return None
                machine.update(block[:count])
                size += count
    except OSError:
        # It was read a moment ago; what is wrong with it now is no matter of the result.
        return LogFileInfo(path=str(path), size_bytes=size, blake2b=None)
    return LogFileInfo(path=str(path), size_bytes=size, blake2b=machine.hexdigest())


def _files_of(path: Path) -> list[Path]:
    """Return the files of a log: itself, or those that stand in its folder; none of standard input."""
    if str(path) == STDIN:
        return []
    if not path.is_dir():
        return [path]
    return sorted((entry for entry in path.iterdir() if entry.is_file()), key=natural)

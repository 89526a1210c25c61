"""A remote file read by parts, in the place of a `LogFile`: an index without the samples."""

import threading
from pathlib import Path

from imucal.readers.files import DamagedError, LogFile
from imucal.remote.remote_log import RemoteFile
from imucal.remote.stores import store_of

#: Bytes of a block: small reads are rounded to these, as an answer takes as long as some of its bytes.
_BLOCK = 1 << 17
#: Beyond this share of the file, and this many bytes, downloading it takes less time than asking for parts.
_SHARE, _LEAST = 4, 1 << 22


class TooMuchError(Exception):
    """So much of the file is asked for that all of it had better be downloaded."""


class RangedFile(LogFile):
    """A file of a store, read by absolute position; safe to share between threads.

    `path` is for messages; nothing has to be there. `fetched` counts the bytes that were asked for.
    """

    def __init__(self, remote: RemoteFile, path: Path) -> None:
        if remote.size is None or not remote.ranges:
            raise TooMuchError
        self.path, self.size = path, remote.size
        self.fetched = 0
        self._remote, self._store = remote, store_of(remote.url)
        self._most = max(_LEAST, remote.size // _SHARE)
        self._blocks: dict[int, bytes] = {}
        self._lock = threading.Lock()

    def close(self) -> None:
        """Let the blocks go."""
        self._blocks.clear()

    def into(self, position: int, view: memoryview) -> None:
        if position < 0 or position + len(view) > self.size:
            msg = f"bytes {position} to {position + len(view)} lie beyond the end of the file"
            raise DamagedError(msg, code="truncated")
        if not len(view):
            return
        first, last = position // _BLOCK, (position + len(view) - 1) // _BLOCK
        with self._lock:
            self._fetch(first, last)
            data = b"".join(self._blocks[index] for index in range(first, last + 1))
        start = position - first * _BLOCK
        view[:] = data[start : start + len(view)]

    def _fetch(self, first: int, last: int) -> None:
        """Ask for the blocks that are missing, neighbours in one request."""
        missing = [index for index in range(first, last + 1) if index not in self._blocks]
        while missing:
            count = next((i for i, index in enumerate(missing) if index != missing[0] + i), len(missing))
            start, stop = missing[0] * _BLOCK, min((missing[count - 1] + 1) * _BLOCK, self.size)
            self.fetched += stop - start
            if self.fetched > self._most:
                raise TooMuchError
            data = self._store.read(self._remote, start, stop)
            for index in missing[:count]:
                at = index * _BLOCK - start
                self._blocks[index] = data[at : at + _BLOCK]
            missing = missing[count:]

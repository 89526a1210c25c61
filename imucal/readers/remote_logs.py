"""Logs given by URL: readers get local copies or parts of a file; messages and results contain the URLs."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

from imucal.errors import ImucalError
from imucal.readers.files import LogFile
from imucal.readers.read_options import Progress
from imucal.recording import LogFileInfo, Recording
from imucal.remote import RemoteLog, is_url
from imucal.remote.addresses import RemoteFile

if TYPE_CHECKING:
    from imucal.remote.copies import LocalCopy

Value = TypeVar("Value")

#: Bytes of a block: latency makes smaller requests inefficient.
_BLOCK = 1 << 17
#: Above this fraction (1/n) of the file and this many bytes, downloading it is faster.
_SHARE, _MIN_BYTES = 4, 1 << 22


@dataclass(frozen=True, slots=True)
class LocalLogs:
    """Logs on this machine, including copies of remote ones."""

    paths: tuple[Path, ...]
    copies: tuple["LocalCopy", ...] = ()

    def with_urls(self, value: Value) -> Value:
        """Replace the paths of copies by URLs without secrets in the texts of a value, or of an error."""
        replaced: Any = value
        if type(value) is str:
            for copy in self.copies:
                replaced = replaced.replace(str(copy.path), copy.log.shown)
        elif isinstance(value, tuple):
            replaced = tuple(map(self.with_urls, value))
        elif isinstance(value, ImucalError):
            replaced = value.at(self.with_urls(value.place))
            replaced.problem = self.with_urls(value.problem)
            replaced.fixes = self.with_urls(value.fixes)
            replaced.also = self.with_urls(value.also)
        elif is_dataclass(value):
            replaced = replace(
                replaced, **{part.name: self.with_urls(getattr(value, part.name)) for part in fields(value)}
            )
        return cast("Value", replaced)

    def named(self, recording: Recording) -> Recording:
        if not self.copies:
            return recording
        source = replace(self.with_urls(recording.source), files=self.named_files(recording.source.files))
        return replace(recording, source=source, findings=self.with_urls(recording.findings))

    def named_files(self, files: Sequence[LogFileInfo]) -> tuple[LogFileInfo, ...]:
        tags = {
            str(path): file.etag
            for copy in self.copies
            for path, file in zip(copy.files, copy.log.files, strict=True)
        }
        return tuple(
            replace(file, path=self.with_urls(file.path), etag=tags.get(file.path) or file.etag)
            for file in files
        )

    @contextmanager
    def errors_named(self) -> Iterator[None]:
        try:
            yield
        except ImucalError as error:
            raise self.with_urls(error) from error


@contextmanager
def local_logs(
    logs: Sequence[str | Path | RemoteLog], *, progress: Progress | None = None
) -> Iterator[LocalLogs]:
    """Yield logs as local files; errors inside the block contain URLs.

    Raises ReadError if a URL can't be fetched.
    """
    if not any(isinstance(log, RemoteLog) or is_url(log) for log in logs):
        yield LocalLogs(tuple(Path(str(log)) for log in logs))
        return
    from imucal.remote.copies import fetched
    from imucal.remote.stores import logs_at

    found: list[Path | RemoteLog] = []
    for log in logs:
        if isinstance(log, RemoteLog):
            found.append(log)
        else:
            found += logs_at(str(log)) if is_url(log) else [Path(log)]
    total = sum(log.size or 0 for log in found if isinstance(log, RemoteLog))
    before = 0
    with ExitStack() as stack:
        paths, copies = [], []
        for one in found:
            if isinstance(one, Path):
                paths.append(one)
                continue
            report = partial(_report_part, progress, before, total) if progress else None
            before += one.size or 0
            copies.append(stack.enter_context(fetched(one, progress=report, exact=one in logs)))
            paths.append(copies[-1].path)
        local = LocalLogs(tuple(paths), tuple(copies))
        with local.errors_named():
            yield local


def _report_part(progress: Progress, before: int, total: int, done: int, _: int) -> None:
    progress(before + done, total)


class TooMuchError(Exception):
    """Downloading the whole file is faster than further requests for parts."""


class RangedFile(LogFile):
    """A file of a store, read by absolute position; thread-safe. `path` is only for messages."""

    def __init__(self, remote: RemoteFile, path: Path) -> None:
        from imucal.remote.stores import store_of

        if remote.size is None or not remote.ranges:
            raise TooMuchError
        self.path, self.size = path, remote.size
        self.fetched = 0
        self._remote, self._store = remote, store_of(remote.url)
        self._most = max(_MIN_BYTES, remote.size // _SHARE)
        self._blocks: dict[int, bytes] = {}
        self._lock = threading.Lock()

    def close(self) -> None:
        self._blocks.clear()

    def _bytes(self, position: int, size: int) -> bytes:
        first, stop = position // _BLOCK, -(-(position + size) // _BLOCK)
        with self._lock:
            self._fetch(range(first, stop))
            data = b"".join(self._blocks[index] for index in range(first, stop))
        start = position - first * _BLOCK
        return data[start : start + size]

    def _fetch(self, wanted: range) -> None:
        missing = [index for index in wanted if index not in self._blocks]
        for _, run in groupby(enumerate(missing), key=lambda item: item[1] - item[0]):
            indices = [index for _, index in run]
            start, stop = indices[0] * _BLOCK, min((indices[-1] + 1) * _BLOCK, self.size)
            self.fetched += stop - start
            if self.fetched > self._most:
                raise TooMuchError
            data = self._store.read(self._remote, start, stop)
            for place, index in enumerate(indices):
                self._blocks[index] = data[place * _BLOCK : (place + 1) * _BLOCK]

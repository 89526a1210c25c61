"""Logs given by URL: readers get local copies; messages and results contain the URLs."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

from imucal.errors import ImucalError
from imucal.readers.read_options import Progress
from imucal.recording import LogFileInfo, Recording
from imucal.remote import RemoteLog, is_url

if TYPE_CHECKING:
    from imucal.remote.copies import LocalCopy

Value = TypeVar("Value")


@dataclass(frozen=True)
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
    from imucal.remote.stores import expand, identify

    found: list[Path | RemoteLog] = []
    for log in logs:
        if isinstance(log, RemoteLog):
            found.append(log)
        elif is_url(log):
            found += map(identify, expand(str(log)))
        else:
            found.append(Path(log))
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
            copies.append(stack.enter_context(fetched(one, progress=report)))
            paths.append(copies[-1].path)
        local = LocalLogs(tuple(paths), tuple(copies))
        with local.errors_named():
            yield local


def _report_part(progress: Progress, before: int, total: int, done: int, _: int) -> None:
    progress(before + done, total)

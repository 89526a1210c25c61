"""ROS 2 bags: folders with metadata.yaml, single `.db3` files, and files compressed by zstd."""

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.assemble import describe_logs, read_logs
from imucal.readers.compression import unpack_file
from imucal.readers.containers.container import Channel, Container, Task
from imucal.readers.containers.mcap_file import McapFile
from imucal.readers.containers.rosbag2_folder import Folder, open_folder
from imucal.readers.containers.sqlite_file import SqliteFile
from imucal.readers.containers.zstd_messages import MAGIC as ZSTD
from imucal.readers.containers.zstd_messages import ZstdMessages
from imucal.readers.contents import LogContents
from imucal.readers.files import DamagedError
from imucal.readers.read_options import Progress, ReadOptions
from imucal.recording import Recording


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the IMU topic of a bag.

    Raises
    ------
    ReadError
        If the bag can't be read; `ChoiceError` if several topics fit or none does.
    """
    containers = open_files(path, options.progress)
    return read_logs(containers, path, options, form=_form(containers))


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the topics of a bag."""
    containers = open_files(path, options.progress)
    return describe_logs(containers, path, options, form=_form(containers))


def open_files(path: Path, progress: Progress | None = None) -> list[Container]:
    """Open the files of a bag: those of a folder, or one."""
    folder = open_folder(path) if path.is_dir() else Folder(files=(path,))
    counts = folder.counts if len(folder.files) == 1 else None
    containers: list[Container] = []
    try:
        for file in folder.files:
            containers.append(_open(file, folder, counts, progress))  # noqa: PERF401 - closed if one fails
    except BaseException:
        for container in containers:
            container.close()
        raise
    if folder.missing:
        names = ", ".join(folder.missing[:5])
        text = f"{len(folder.missing)} files of the bag are missing: {names}; their time is a gap."
        containers[0].findings.append(Finding(level="warning", code="file-missing", text=text))
    return containers


def _form(containers: list[Container]) -> str:
    return "rosbag2-mcap" if containers[0].format == "mcap" else containers[0].format


def _open(
    path: Path, folder: Folder, counts: Mapping[str, int] | None, progress: Progress | None
) -> Container:
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(ZSTD):
        return _Unpacked(path, folder, counts, progress)
    if head.startswith(b"SQLite format 3"):
        base = SqliteFile(path, counts)
        return ZstdMessages(base) if folder.per_message or base.sample() == ZSTD else base
    if head.startswith(b"\x89MCAP") or path.name.endswith(".mcap"):
        log = McapFile(path)
        return ZstdMessages(log) if folder.per_message else log
    msg = f"{path}: neither SQLite nor MCAP (first bytes {head[:8].hex(' ')}); expected a file of a ROS 2 bag"
    raise ReadError(msg)


class _Unpacked:
    """A file compressed as a whole, unpacked into a temporary one that goes when it is closed."""

    def __init__(
        self, path: Path, folder: Folder, counts: Mapping[str, int] | None, progress: Progress | None
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="imucal-")
        target = Path(self._folder.name) / path.name.removesuffix(".zst").removesuffix(".zstd")
        size = path.stat().st_size
        damage: DamagedError | None = None
        try:
            with target.open("wb") as file:
                unpack_file(path, file, lambda done: progress(done, size) if progress else None)
        except DamagedError as error:
            damage = error
        except OSError as error:
            self._folder.cleanup()
            msg = f"{path}: can't be unpacked to {target.parent}: {error.strerror or error}"
            raise ReadError(msg) from error
        try:
            self._inner = _open(target, folder, counts, None)
        except ReadError as error:
            self._folder.cleanup()
            msg = str(error).replace(str(target), str(path))
            raise type(error)(msg) from error
        self.path, self.format, self.size = path, self._inner.format, size
        self.parallel = self._inner.parallel
        self.compression = "zstd, whole file"
        self.start_ns, self.end_ns = self._inner.start_ns, self._inner.end_ns
        self.findings = self._inner.findings
        if damage is not None:
            text = f"The file is cut or damaged: {damage}; what came before is read."
            self.findings.append(Finding(level="warning", code="truncated", text=text))
        self.channels: list[Channel] = list(self._inner.channels)

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        return self._inner.tasks(keys)

    def close(self) -> None:
        self._inner.close()
        self._folder.cleanup()

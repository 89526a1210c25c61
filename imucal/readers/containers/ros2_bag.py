"""ROS 2 bags: folders with metadata.yaml, single `.db3` files, and zstd-compressed files or messages."""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from inspect import get_annotations
from pathlib import Path

from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.compression import unpack_file
from imucal.readers.containers.container import Batch, Container, Task
from imucal.readers.containers.mcap import McapFile
from imucal.readers.containers.rosbag2_folder import Folder, open_folder
from imucal.readers.containers.sqlite import SqliteFile, batch_of_blobs
from imucal.readers.files import DamagedError, damaged_if, refused
from imucal.readers.read_options import Progress

#: Signature of a zstd frame.
_ZSTD = b"\x28\xb5\x2f\xfd"
#: A larger compressed message is damage, in bytes; messages of an IMU have about 300.
_MAX_MESSAGE = 1 << 20
#: Most bytes of the messages that are decompressed at once.
_MAX_BATCH = 1 << 28


def open_files(path: Path, progress: Progress | None = None) -> tuple[list[Container], str]:
    """Open the files of a bag and return its format; raises ReadError if it can't be read."""
    folder = open_folder(path) if path.is_dir() else Folder(files=(path,))
    counts = folder.metadata.topic_counts if len(folder.files) == 1 and not folder.missing else None
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
        containers[0].findings.append(Finding("warning", "file-missing", text))
    else:
        containers[0].findings.extend(_count_findings(folder, containers))
    form = containers[0].format
    return containers, "rosbag2-mcap" if form == "mcap" else form


def _count_findings(folder: Folder, containers: Sequence[Container]) -> Iterator[Finding]:
    """Yield a finding if the metadata count other numbers of messages than the files."""
    topics: dict[str, int | None] = {}
    files: dict[str, int | None] = {}
    for path, container in zip(folder.files, containers, strict=True):
        files[path.name] = _sum(channel.count for channel in container.channels)
        for channel in container.channels:
            topics[channel.topic] = _sum((topics.get(channel.topic, 0), channel.count))
    differences = [
        f"{stated} messages of topic {topic}, and its files contain {topics[topic]}"
        for topic, stated in folder.metadata.topic_counts.items()
        # Names with escapes are not decoded; the number of all messages covers their topics.
        if topics.get(topic) not in {None, stated}
    ]
    for file, stated in folder.metadata.file_counts.items():
        # The file may have been compressed or unpacked since.
        if files.get(Path(file).name) not in {None, stated}:
            differences.append(f"{stated} messages in {file}, which contains {files[Path(file).name]}")
    total, stated_total = _sum(files.values()), folder.metadata.total
    if total is not None and stated_total not in {None, total}:
        differences.append(f"{stated_total} messages in all, and its files contain {total}")
    if differences:
        text = f"metadata.yaml of the bag counts {differences[0]}."
        yield Finding("warning", "damaged", text, "Copy the bag again.")


def _sum(counts: Iterable[int | None]) -> int | None:
    """Return the sum of counts; None if one is unknown."""
    known = list(counts)
    return None if None in known else sum(count or 0 for count in known)


def _open(
    path: Path, folder: Folder, counts: Mapping[str, int] | None, progress: Progress | None
) -> Container:
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(_ZSTD):
        return _Unpacked(path, lambda unpacked: _open(unpacked, folder, counts, None), progress)
    if head.startswith(b"SQLite format 3"):
        base = SqliteFile(path, counts)
        return _ZstdMessages(base) if folder.per_message or base.sample() == _ZSTD else base
    if head.startswith(b"\x89MCAP") or path.name.endswith(".mcap"):
        log = McapFile(path)
        return _ZstdMessages(log) if folder.per_message else log
    found = f"neither SQLite nor MCAP (first bytes {head[:8].hex(' ')})"
    raise refused(path, f"{found}; expected a file of a ROS 2 bag")


class _Wrapped(Container):
    """A container that forwards to another one."""

    def __init__(self, inner: Container) -> None:
        self._inner = inner
        for name in get_annotations(Container):
            setattr(self, name, getattr(inner, name))

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        return self._inner.tasks(keys)

    def close(self) -> None:
        self._inner.close()


class _Unpacked(_Wrapped):
    """A compressed file, unpacked into a temporary folder until it is closed."""

    def __init__(
        self, path: Path, open_inner: Callable[[Path], Container], progress: Progress | None
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
        except ReadError:
            self._folder.cleanup()
            raise
        except OSError as error:
            self._folder.cleanup()
            raise refused(path, f"can't be unpacked to {target.parent}: {error.strerror or error}") from error
        try:
            super().__init__(open_inner(target))
        except ReadError as error:
            self._folder.cleanup()
            named = error.at(path)
            if damage is not None:
                named.problem += f" (cut off or damaged: {damage})"
            raise named from error
        self.path, self.size, self.compression = path, size, "zstd, whole file"
        if damage is not None:
            text = f"The file is cut off or damaged: {damage}; the part before was read."
            self.findings.append(Finding("warning", "truncated", text))

    def close(self) -> None:
        super().close()
        self._folder.cleanup()


class _ZstdMessages(_Wrapped):
    """A container with separately compressed messages (rosbag2's compression mode MESSAGE)."""

    def __init__(self, inner: Container) -> None:
        super().__init__(inner)
        self.compression, self.parallel = "zstd, each message", False

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        for task in self._inner.tasks(keys):
            yield task._replace(load=partial(_load_decompressed, task))


def _load_decompressed(task: Task) -> Iterator[tuple[int, Batch]]:
    for key, batch in task.load():
        yield key, _decompressed(batch)


def _decompressed(batch: Batch) -> Batch:
    import zstandard

    machine = zstandard.ZstdDecompressor()
    blobs: list[bytes] = []
    size = 0
    try:
        for frame in batch.messages():
            stated = zstandard.frame_content_size(frame)
            if stated > _MAX_MESSAGE:
                found = f"a compressed message of {len(frame)} bytes declares {stated}"
                raise DamagedError(f"{found}; expected at most {_MAX_MESSAGE}")
            blobs.append(machine.decompress(frame, max_output_size=_MAX_MESSAGE))
            size += len(blobs[-1])
            damaged_if(size > _MAX_BATCH, f"compressed messages unpack to more than {_MAX_BATCH} bytes")
    except (zstandard.ZstdError, MemoryError) as error:
        raise DamagedError(f"a compressed message is damaged: {error}") from error
    return replace(batch_of_blobs(blobs, batch.log_ns.tolist()), loss=batch.loss)

"""A container whose messages are compressed one by one (rosbag2's compression mode MESSAGE)."""

from collections.abc import Iterator
from typing import cast

from imucal.readers.containers.batch import Batch
from imucal.readers.containers.container import Container, Task
from imucal.readers.containers.sqlite_file import batch_of_blobs
from imucal.readers.files import DamagedError, Scratch

#: First bytes of a zstd frame.
MAGIC = b"\x28\xb5\x2f\xfd"
#: A message that claims more than this is damaged, in bytes.
_MAX_MESSAGE = 1 << 28


class ZstdMessages:
    """Another container, with its messages decompressed."""

    compression = "zstd, each message"
    parallel = False

    def __init__(self, inner: Container) -> None:
        self._inner = inner
        self.path, self.format, self.size = inner.path, inner.format, inner.size
        self.channels, self.findings = inner.channels, inner.findings
        self.start_ns, self.end_ns = inner.start_ns, inner.end_ns

    def close(self) -> None:
        """Close the container."""
        self._inner.close()

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the tasks of the container, each with decompression."""
        for task in self._inner.tasks(keys):
            yield cast("Task", _ZstdTask(task))


class _ZstdTask:
    """A task whose messages are decompressed one by one."""

    def __init__(self, inner: Task) -> None:
        self._inner = inner
        self.counts, self.size = inner.counts, inner.size

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each wanted channel; see `Task`."""
        for key, batch in self._inner.load(scratch):
            yield key, _unpacked(batch.checked())


def _unpacked(batch: Batch) -> Batch:
    import zstandard

    machine = zstandard.ZstdDecompressor()
    starts = batch.payload()
    ends = (starts + batch.sizes).tolist()
    view = memoryview(batch.buffer)
    blobs = []
    try:
        for start, end in zip(starts.tolist(), ends, strict=True):
            frame = view[start:end]
            if zstandard.frame_content_size(frame) > _MAX_MESSAGE:
                msg = "a compressed message claims an impossible size"
                raise DamagedError(msg)
            blobs.append(machine.decompress(frame, max_output_size=_MAX_MESSAGE))
    except (zstandard.ZstdError, MemoryError) as error:
        msg = f"a compressed message is damaged: {error}"
        raise DamagedError(msg) from error
    return batch_of_blobs(blobs, batch.log_ns.tolist())

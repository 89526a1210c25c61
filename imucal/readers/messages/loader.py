"""Chunks -> columns: decoded in parallel if possible, appended in the order of the file."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from imucal.readers.compression import keep_freed_memory
from imucal.readers.containers import Batch, Container, Loss, Task
from imucal.readers.files import DamagedError
from imucal.readers.growing import GrowingColumn
from imucal.readers.read_options import Progress
from imucal.resources import threads as allowed_threads

#: Columns of messages, shape (n,) each: log times in ns, then the requested numbers.
Block: TypeAlias = Sequence[NDArray[Any]]

T = TypeVar("T")
R = TypeVar("R")

#: The interpreter's lock makes more threads useless.
_MAX_THREADS = 4
#: Preparing the allocator is worthwhile above this number of messages.
_LARGE = 50_000
#: Chunks searched for a channel's first message.
_LOOKS = 8
_MAX_LOSSES = 1000
#: Least bytes of a message in a file: an index entry.
MIN_MESSAGE_BYTES = 12


class Decoder(Protocol):
    """Decodes the messages of one channel."""

    #: A batch with a damaged message is decoded again in groups of this size: a batch of a database contains
    #: 10 000 messages.
    @property
    def group(self) -> int: ...

    def decode(self, batch: Batch) -> Block:
        """Return the samples; raises DamagedError if a message can't be decoded."""


@dataclass(eq=False)
class Stream:
    """A topic to decode: types of its columns, and decoders by (container, channel key)."""

    types: Sequence[type[np.generic]]
    decoders: dict[tuple[int, int], Decoder]


@dataclass(frozen=True, eq=False)
class Decoding:
    """The columns of a stream, log time first, and the losses."""

    columns: Block
    losses: list[Loss]
    #: Messages counted but not found; None without a count.
    missing: int | None


def decode(
    containers: Sequence[Container],
    streams: Sequence[Stream],
    *,
    progress: Progress | None = None,
    most_chunks: int | None = None,
    between_ns: tuple[int, int] | None = None,
) -> list[Decoding]:
    """Decode streams; with `most_chunks` only the start of the first file with messages.

    With `between_ns` only messages recorded from the first of these times to before the second, in ns.
    """
    jobs = list(_jobs(containers, streams, most_chunks))
    # Counts can be wrong, so the file's size limits the reserved memory.
    most = sum(container.size for container in containers) // MIN_MESSAGE_BYTES if most_chunks is None else 0
    most = 0 if between_ns is not None else most
    outputs = [_Output(stream.types, _stated(containers, stream), most) for stream in streams]
    if sum(output.expected for output in outputs) > _LARGE:
        keep_freed_memory()
    parallel = all(container.parallel for container in containers)
    threads = min(_MAX_THREADS, allowed_threads(), len(jobs)) if parallel else 1
    done, total = 0, sum(task.size for _, task in jobs)
    decoded = _in_order(jobs, partial(_decoded, streams, between_ns), threads)
    for (_, task), results in zip(jobs, decoded, strict=True):
        for index, n, pieces in results:
            outputs[index].add(n, pieces)
        done += task.size
        if progress is not None:
            progress(done, total)
    return [output.decoding() for output in outputs]


class _Output:
    """The decoded samples of a stream; memory is reserved for `stated` messages, at most `most`."""

    def __init__(self, types: Sequence[type[np.generic]], stated: int | None, most: int) -> None:
        self._stated, self._found = stated, 0
        self.expected = min(stated or 0, most)
        every: list[type[np.generic]] = [np.int64, *types]
        self._columns = [GrowingColumn(one, expected=self.expected) for one in every]
        self._losses: list[Loss] = []

    def add(self, n: int, pieces: Sequence[Block | Loss]) -> None:
        self._found += n
        for piece in pieces:
            if not isinstance(piece, Loss):
                for column, values in zip(self._columns, piece, strict=True):
                    column.append(values)
            elif len(self._losses) < _MAX_LOSSES:
                self._losses.append(piece)

    def decoding(self) -> Decoding:
        columns = [column.take() for column in self._columns]
        missing = None if self._stated is None else max(self._stated - self._found, 0)
        return Decoding(columns, self._losses, missing)


def first_message(container: Container, key: int, chunks: int | None = _LOOKS) -> bytes | None:
    """Return a channel's first complete message in some chunks (None: all)."""
    for task in islice(container.tasks(frozenset({key})), chunks):
        with suppress(DamagedError):
            for _, batch in task.load():
                if batch.n:
                    return bytes(next(batch.messages()))
    return None


def _stated(containers: Sequence[Container], stream: Stream) -> int | None:
    channels = [(at, channel) for at, one in enumerate(containers) for channel in one.channels]
    counts = [channel.count for at, channel in channels if (at, channel.key) in stream.decoders]
    return None if None in counts else sum(count or 0 for count in counts)


def _jobs(
    containers: Sequence[Container], streams: Sequence[Stream], most_chunks: int | None
) -> Iterator[tuple[int, Task]]:
    for at, container in enumerate(containers):
        keys = frozenset(key for stream in streams for other, key in stream.decoders if other == at)
        tasks = list(islice(container.tasks(keys), most_chunks)) if keys else []
        yield from ((at, task) for task in tasks)
        if most_chunks is not None and tasks:
            return


def _in_order(jobs: Sequence[T], work: Callable[[T], R], threads: int) -> Iterator[R]:
    """Yield results in the order of jobs; threads work only a few jobs ahead."""
    if threads < 2:
        yield from map(work, jobs)
        return
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[R]] = deque()
        try:
            for job in jobs:
                waiting.append(pool.submit(work, job))
                if len(waiting) > 2 * threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            # An error or interrupt stops each thread after its job.
            for future in waiting:
                future.cancel()


def _decoded(
    streams: Sequence[Stream], between_ns: tuple[int, int] | None, job: tuple[int, Task]
) -> list[tuple[int, int, list[Block | Loss]]]:
    """Return for each stream in a chunk: index, number of messages, samples and losses."""
    at, task = job
    results: list[tuple[int, int, list[Block | Loss]]] = []
    missing = set(task.keys)
    try:
        for key, batch in task.load():
            missing.discard(key)
            wanted = batch if between_ns is None else _recorded(batch, *between_ns)
            for index, stream in enumerate(streams):
                if (at, key) not in stream.decoders:
                    continue
                pieces: list[Block | Loss] = []
                if batch.loss:
                    pieces.append(batch.loss)
                if wanted.n:
                    pieces += _pieces(stream.decoders[at, key], wanted)
                results.append((index, batch.n, pieces))
    except DamagedError as error:
        loss = Loss(error.code, str(error), None)
        concerned = [any((at, key) in stream.decoders for key in missing) for stream in streams]
        results += [(index, 0, [loss]) for index, hit in enumerate(concerned) if hit]
    return results


def _recorded(batch: Batch, first_ns: int, end_ns: int) -> Batch:
    """Return the messages that were recorded in a range of times."""
    return batch.part(np.flatnonzero((batch.log_ns >= first_ns) & (batch.log_ns < end_ns)))


def _pieces(decoder: Decoder, batch: Batch) -> list[Block | Loss]:
    """Return the samples of a batch; groups with a damaged message are lost."""
    try:
        return [decoder.decode(batch)]
    except DamagedError as error:
        if batch.n <= decoder.group or error.code in {"encapsulation", "definition"}:
            return [Loss(error.code, str(error), batch.n)]
    pieces: list[Block | Loss] = []
    for first in range(0, batch.n, decoder.group):
        pieces += _pieces(decoder, batch.part(slice(first, first + decoder.group)))
    return pieces

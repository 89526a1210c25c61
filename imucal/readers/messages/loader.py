"""Chunks -> columns: every chunk into its own rows, in parallel where the container allows it."""

import threading
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from operator import itemgetter
from typing import Protocol

from imucal.readers.compression import keep_freed_memory
from imucal.readers.containers import Batch, Container, Loss, Task
from imucal.readers.files import DamagedError, Scratch
from imucal.readers.messages.message_types import ImuFields
from imucal.readers.read_options import Progress
from imucal.readers.store import Block, Columns
from imucal.resources import threads as allowed_threads

#: More threads gain nothing: the interpreter's lock is held in between.
_MAX_THREADS = 4
#: Logs of more messages have chunks enough to make up for preparing the allocator.
_LARGE = 50_000
#: Chunks in which the first message of a channel is looked for.
_LOOKS = 8
#: Losses kept word by word; the rest is counted.
_MAX_LOSSES = 1000
#: If more messages than these are damaged in a row, the others are not tried one by one.
_MANY = 64


class Decoder(Protocol):
    """Decodes the messages of one channel."""

    def decode(self, batch: Batch) -> Block:
        """Return the samples of messages; raises DamagedError if one can't be decoded."""


@dataclass(slots=True, eq=False)
class Stream:
    """One topic to decode: what to take, and who decodes each channel of each container."""

    imu: ImuFields
    decoders: dict[tuple[int, int], Decoder]


@dataclass(slots=True, eq=False)
class Decoding:
    """What decoding a stream gave: its columns, in the order of the file, and what was lost."""

    columns: Columns
    losses: list[Loss] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class _Target:
    """Where the messages of a stream go."""

    columns: Columns
    #: Spans of the columns (first, last + 1) that were written.
    filled: list[tuple[int, int]] = field(default_factory=list)
    #: Columns that found no room, and what was lost, each with the number of its chunk: threads are not done
    #: with chunks in their order.
    extra: list[tuple[int, Columns]] = field(default_factory=list)
    losses: list[tuple[int, Loss]] = field(default_factory=list)

    def decoding(self) -> Decoding:
        """Return what the stream gave, in the order of the chunks, and as it was found in each."""
        losses = [loss for _, loss in sorted(self.losses, key=itemgetter(0))][:_MAX_LOSSES]
        columns = self.columns
        columns.keep_spans(_merged(self.filled))
        if self.extra:
            columns = columns.joined([more for _, more in sorted(self.extra, key=itemgetter(0))])
        columns.release()
        return Decoding(columns, losses)


@dataclass(slots=True, eq=False)
class _Part:
    """The messages of a channel in one chunk: its number, where they go, and who decodes them.

    They have room for `most` messages from row `first` on.
    """

    number: int
    key: int
    target: int
    decoder: Decoder
    first: int
    most: int


def decode(
    containers: Sequence[Container],
    streams: Sequence[Stream],
    *,
    limit: int | None = None,
    progress: Progress | None = None,
    most_chunks: int | None = None,
) -> list[Decoding]:
    """Decode streams from containers; at most `most_chunks` of the first file that holds messages.

    Of the samples, `limit` bytes are held in memory before a temporary file takes them.
    """
    return _Run(containers, streams, limit, progress, most_chunks=most_chunks).go()


def first_message(container: Container, key: int, chunks: int | None = _LOOKS) -> bytes | None:
    """Return the first whole message of a channel; None where there is none in some chunks, or in all."""
    scratch = Scratch()
    for task in islice(container.tasks(frozenset({key})), chunks):
        with suppress(DamagedError):
            for _, batch in task.load(scratch):
                if batch.n:
                    return bytes(next(batch.messages()))
    return None


class _Run:
    """One decoding of several streams; the target of a stream stands at its index."""

    def __init__(
        self,
        containers: Sequence[Container],
        streams: Sequence[Stream],
        limit: int | None,
        progress: Progress | None,
        *,
        most_chunks: int | None,
    ) -> None:
        self.streams = streams
        totals = [0] * len(streams)
        self.jobs = list(self._plan(containers, totals, most_chunks))
        self.targets = []
        for imu, total in zip((stream.imu for stream in streams), totals, strict=True):
            axes = tuple(len(vector.axes) for vector in imu.vectors)
            warm = bool(imu.temperature)
            self.targets.append(
                _Target(Columns(total, imu.sensors, temperature=warm, limit=limit, axes=axes))
            )
        self.parallel = all(container.parallel for container in containers)
        self.progress = progress
        self.done, self.total = 0, sum(task.size for task, _ in self.jobs)
        self.lock = threading.Lock()

    def _plan(
        self, containers: Sequence[Container], totals: list[int], most_chunks: int | None
    ) -> Iterator[tuple[Task, list[_Part]]]:
        """Yield the tasks, the parts of each with room behind those before; adds up the `totals`."""
        jobs = 0
        for at, container in enumerate(containers):
            keys = frozenset(key for stream in self.streams for other, key in stream.decoders if other == at)
            before = jobs
            for task in islice(container.tasks(keys) if keys else (), most_chunks):
                parts = []
                for index, stream in enumerate(self.streams):
                    for key, count in task.counts.items():
                        if (at, key) in stream.decoders:
                            parts.append(
                                _Part(jobs, key, index, stream.decoders[at, key], totals[index], count)
                            )
                            totals[index] += count
                yield task, parts
                jobs += 1
            if most_chunks is not None and jobs > before:
                return

    def go(self) -> list[Decoding]:
        if sum(target.columns.n for target in self.targets) > _LARGE:
            keep_freed_memory()
        threads = min(_MAX_THREADS, allowed_threads(), len(self.jobs)) if self.parallel else 1
        if threads > 1:
            self._in_threads(threads)
        else:
            scratch = Scratch()
            for job in self.jobs:
                self._work(*job, scratch)
        return [target.decoding() for target in self.targets]

    def _in_threads(self, threads: int) -> None:
        """Each thread takes the next chunk when it is done with one, so that writes stay near each other."""
        # The first chunk, by which the definition is chosen, is the same however many threads there are.
        self._work(*self.jobs[0], Scratch())
        held = threading.local()

        def start() -> None:
            held.scratch = Scratch()

        with ThreadPoolExecutor(threads, initializer=start) as pool:
            # An error, or an interrupt of the user, ends all threads after the chunk they are in.
            deque(pool.map(lambda job: self._work(job[0], job[1], held.scratch), self.jobs[1:]), maxlen=0)

    def _work(self, task: Task, parts: list[_Part], scratch: Scratch) -> None:
        """Decode one chunk into every stream."""
        seen: set[int] = set()
        try:
            for key, batch in task.load(scratch):
                seen.add(key)
                for part in parts:
                    if part.key == key and batch.n:
                        self._decode(part, batch)
                    elif part.key == key:
                        self._lose(part, batch.loss)
        except DamagedError as error:
            for part in parts:
                if part.key not in seen:
                    self._lose(part, _loss(error, part.most))
        if self.progress is not None:
            with self.lock:
                self.done += task.size
                self.progress(self.done, self.total)

    def _decode(self, part: _Part, batch: Batch) -> None:
        target = self.targets[part.target]
        pieces = _pieces(part.decoder, batch)
        for loss in (batch.loss, *pieces):
            if isinstance(loss, Loss):
                self._lose(part, loss)
        blocks = [piece for piece in pieces if not isinstance(piece, Loss)]
        n = sum(block[0].size for block in blocks)
        # The index counted too few: all messages of the chunk go behind all others.
        extra = n > part.most
        columns, first = (target.columns.like(n), 0) if extra else (target.columns, part.first)
        start = first
        for block in blocks:
            stop = start + block[0].size
            for row, values in zip(columns.rows, block, strict=True):
                row[start:stop] = values
            start = stop
        if extra:
            with self.lock:
                target.extra.append((part.number, columns))
        else:
            self._note_filled(target.filled, columns, first, n)

    def _note_filled(self, spans: list[tuple[int, int]], columns: Columns, first: int, n: int) -> None:
        with self.lock:
            spans.append((first, first + n))
            columns.wrote(8 * n * len(columns.rows))

    def _lose(self, part: _Part, loss: Loss | None) -> None:
        if loss is None:
            return
        with self.lock:
            target = self.targets[part.target]
            target.losses.append((part.number, loss))
            if len(target.losses) >= 2 * _MAX_LOSSES:
                # Those of the first chunks stay, whichever thread came first.
                target.losses = sorted(target.losses, key=itemgetter(0))[:_MAX_LOSSES]


def _pieces(decoder: Decoder, batch: Batch, *, split: bool = True) -> list[Block | Loss]:
    """Return the samples of messages; if some are damaged, halve the batch down to the damaged ones.

    If all of many are damaged, the type itself is wrong, and the others are not split.
    """
    try:
        return [decoder.decode(batch)]
    except DamagedError as error:
        if batch.n == 1 or not split or error.code in {"encapsulation", "definition"}:
            return [_loss(error, batch.n)]
    half = batch.n // 2
    first = _pieces(decoder, batch.part(slice(half)))
    hopeless = half > _MANY and all(isinstance(piece, Loss) for piece in first)
    return first + _pieces(decoder, batch.part(slice(half, None)), split=not hopeless)


def _loss(error: DamagedError, messages: int) -> Loss:
    return Loss(error.code, str(error), messages)


def _merged(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Join spans that touch, in order."""
    merged: list[tuple[int, int]] = []
    for start, stop in sorted(spans):
        if merged and merged[-1][1] == start:
            merged[-1] = (merged[-1][0], stop)
        else:
            merged.append((start, stop))
    return merged

"""Chunks -> columns: every chunk into its own rows, in parallel where the container allows it."""

import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice
from operator import itemgetter
from typing import Protocol, TypeVar

import numpy as np

from imucal.readers.compression import keep_freed_memory
from imucal.readers.containers import Batch, Container, Loss, Task
from imucal.readers.files import DamagedError, Scratch
from imucal.readers.messages.message_types import ImuFields
from imucal.readers.messages.trees import ListDecoder
from imucal.readers.read_options import Progress
from imucal.readers.store import Columns
from imucal.resources import threads as allowed_threads

#: More threads gain nothing: the interpreter's lock is held in between.
_MAX_THREADS = 4
#: Logs of more messages have chunks enough to make up for preparing the allocator.
_LARGE = 50_000
#: Chunks in which the first message of a channel is looked for.
_LOOKS = 8
#: Losses kept word by word; the rest is counted.
_MAX_LOSSES = 1000


class Decoder(Protocol):
    """Turns the messages of one channel into numbers; `notes` is what was found in doing so."""

    notes: list[Loss]

    def settle(self, batch: Batch) -> None:
        """Look at the first messages, once."""

    def fast(self, batch: Batch, columns: Columns, first: int) -> bool:
        """Decode messages that are all alike; False if they are not."""

    def slow(self, batch: Batch, columns: Columns, first: int) -> None:
        """Decode checked messages that may differ; raises DamagedError."""


_Found = TypeVar("_Found", Loss, Columns)


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
class _Job:
    """A task, and where its messages go: (stream, key) -> first row and room."""

    number: int
    container: int
    task: Task
    rooms: dict[tuple[int, int], tuple[int, int]] = field(default_factory=dict)


def decode(
    containers: Sequence[Container],
    streams: Sequence[Stream],
    *,
    limit: int | None = None,
    progress: Progress | None = None,
    most_chunks: int | None = None,
) -> list[Decoding]:
    """Decode streams from containers.

    Parameters
    ----------
    limit
        Bytes of samples to hold in memory before a temporary file takes them.
    most_chunks
        Decode only so many chunks of the first file that holds messages.
    """
    return _Run(containers, streams, limit, progress, most_chunks=most_chunks).go()


def first_message(container: Container, key: int) -> bytes | None:
    """Return the first whole message of a channel; None where there is none in the first chunks."""
    for task in islice(container.tasks(frozenset({key})), _LOOKS):
        try:
            for found, batch in task.load(Scratch()):
                checked = batch.checked()
                if found == key and checked.n:
                    size = checked.sizes if isinstance(checked.sizes, int) else int(checked.sizes[0])
                    start = int(checked.payload()[0])
                    return bytes(memoryview(checked.buffer)[start : start + size])
        except DamagedError:
            continue
    return None


class _Run:
    """One decoding of several streams; what belongs to a stream stands at its index."""

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
        self.decodings = [
            Decoding(_columns(stream.imu, total, limit))
            for stream, total in zip(streams, totals, strict=True)
        ]
        self.filled: list[list[tuple[int, int]]] = [[] for _ in streams]
        #: Columns that found no room, and what was lost, each with the number of its chunk: threads are not
        #: done with chunks in their order.
        self.extra: list[list[tuple[int, Columns]]] = [[] for _ in streams]
        self.losses: list[list[tuple[int, Loss]]] = [[] for _ in streams]
        self.parallel = all(container.parallel for container in containers)
        self.progress = progress
        self.done, self.total = 0, sum(job.task.size for job in self.jobs)
        self.lock = threading.Lock()

    def _plan(
        self, containers: Sequence[Container], totals: list[int], most_chunks: int | None
    ) -> Iterator[_Job]:
        """Yield the tasks, each with room behind that of the ones before; adds up the `totals`."""
        jobs = 0
        for number, container in enumerate(containers):
            keys = frozenset(key for stream in self.streams for at, key in stream.decoders if at == number)
            tasks = container.tasks(keys) if keys else iter(())
            found = False
            for task in islice(tasks, most_chunks):
                found = True
                yield self._job(jobs, number, task, totals)
                jobs += 1
            if most_chunks is not None and found:
                return

    def _job(self, number: int, container: int, task: Task, totals: list[int]) -> _Job:
        job = _Job(number, container, task)
        for index, stream in enumerate(self.streams):
            for key, count in task.counts.items():
                if (container, key) in stream.decoders:
                    job.rooms[index, key] = (totals[index], count)
                    totals[index] += count
        return job

    def go(self) -> list[Decoding]:
        if sum(decoding.columns.n for decoding in self.decodings) > _LARGE:
            keep_freed_memory()
        threads = min(_MAX_THREADS, allowed_threads(), len(self.jobs)) if self.parallel else 1
        if threads > 1:
            self._in_threads(threads)
        else:
            scratch = Scratch()
            for job in self.jobs:
                self._work(job, scratch)
        for index, decoding in enumerate(self.decodings):
            decoders = self.streams[index].decoders.values()
            decoding.losses += [loss for _, loss in _in_order(self.losses[index])][:_MAX_LOSSES]
            decoding.losses += [note for decoder in decoders for note in decoder.notes]
            decoding.columns.keep_spans(_merged(self.filled[index]))
            if self.extra[index]:
                more = [columns for _, columns in _in_order(self.extra[index])]
                decoding.columns = decoding.columns.joined(more)
            decoding.columns.release()
        return self.decodings

    def _in_threads(self, threads: int) -> None:
        """Each thread takes the next chunk when it is done with one, so that writes stay near each other."""
        jobs = iter(self.jobs)
        # The first chunk, by which the definition is chosen, is the same however many threads there are.
        self._work(next(jobs), Scratch())
        stop = threading.Event()

        def work() -> None:
            scratch = Scratch()
            while not stop.is_set():
                with self.lock:
                    job = next(jobs, None)
                if job is None:
                    return
                self._work(job, scratch)

        with ThreadPoolExecutor(threads) as pool:
            try:
                for future in [pool.submit(work) for _ in range(threads)]:
                    future.result()
            finally:
                # An error, or an interrupt of the user, ends all threads after the chunk they are in.
                stop.set()

    def _work(self, job: _Job, scratch: Scratch) -> None:
        """Decode one chunk into every stream."""
        seen: set[int] = set()
        try:
            for key, batch in job.task.load(scratch):
                seen.add(key)
                for index, stream in enumerate(self.streams):
                    if (index, key) in job.rooms and batch.n:
                        decoder = stream.decoders[job.container, key]
                        self._decode(_Part(job.number, index, decoder), batch, job.rooms[index, key])
        except DamagedError as error:
            for (index, key), (_, room) in job.rooms.items():
                if key not in seen:
                    self._lose(job.number, index, _loss(error, room))
        if self.progress is not None:
            with self.lock:
                self.done += job.task.size
                self.progress(self.done, self.total)

    def _decode(self, part: "_Part", batch: Batch, room: tuple[int, int]) -> None:
        index, decoder = part.index, part.decoder
        columns = self.decodings[index].columns
        first, most = room
        lists = isinstance(decoder, ListDecoder)
        try:
            with self.lock:
                decoder.settle(batch)
            if not lists and batch.n <= most and decoder.fast(batch, columns, first):
                self._note_filled(self.filled[index], columns, first, batch.n)
                if batch.loss is not None:
                    self._lose(part.number, index, batch.loss)
                return
            checked = batch.checked()
        except DamagedError as error:
            self._lose(part.number, index, _loss(error, batch.n))
            return
        if checked.loss is not None:
            self._lose(part.number, index, checked.loss)
        if isinstance(decoder, ListDecoder):
            more, losses = decoder.elements(checked, columns)
            for loss in losses:
                self._lose(part.number, index, loss)
        elif checked.n <= most:
            self._slow(part, checked, (columns, first), self.filled[index])
            return
        else:
            # The index counted too few: what it left out goes behind all others.
            more = columns.like(checked.n)
            spans: list[tuple[int, int]] = []
            self._slow(part, checked, (more, 0), spans)
            more.keep_spans(_merged(spans))
        with self.lock:
            self.extra[index].append((part.number, more))

    def _slow(
        self, part: "_Part", batch: Batch, to: tuple[Columns, int], spans: list[tuple[int, int]]
    ) -> None:
        """Decode message by message where some are damaged: halves, down to the bad ones.

        Adds the samples that were written to the `spans`.
        """
        if not batch.n:
            return
        columns, first = to
        try:
            part.decoder.slow(batch, columns, first)
        except DamagedError as error:
            if batch.n == 1 or part.hopeless or error.code in {"encapsulation", "definition"}:
                self._lose(part.number, part.index, _loss(error, batch.n))
                return
            before, half, chosen = len(spans), batch.n // 2, np.arange(batch.n)
            self._slow(part, batch.part(chosen[:half]), (columns, first), spans)
            self._slow(part, batch.part(chosen[half:]), (columns, first + half), spans)
            part.hopeless |= batch.n > 64 and len(spans) == before
            return
        self._note_filled(spans, columns, first, batch.n)

    def _note_filled(self, spans: list[tuple[int, int]], columns: Columns, first: int, n: int) -> None:
        with self.lock:
            spans.append((first, first + n))
            columns.wrote(8 * n * len(columns.rows))

    def _lose(self, number: int, index: int, loss: Loss) -> None:
        with self.lock:
            losses = self.losses[index]
            losses.append((number, loss))
            if len(losses) >= 2 * _MAX_LOSSES:
                # Those of the first chunks stay, whichever thread came first.
                self.losses[index] = _in_order(losses)[:_MAX_LOSSES]


@dataclass(slots=True, eq=False)
class _Part:
    """The messages of a channel in one chunk: its number, the stream, and who decodes them.

    They are `hopeless` when all of many were damaged: the type itself is wrong then, and each of the others
    would be tried in vain.
    """

    number: int
    index: int
    decoder: Decoder
    hopeless: bool = False


def _columns(imu: ImuFields, n: int, limit: int | None) -> Columns:
    axes = tuple(len(vector.axes) for vector in imu.vectors)
    return Columns(n, imu.sensors, temperature=bool(imu.temperature), limit=limit, axes=axes)


def _in_order(found: list[tuple[int, _Found]]) -> list[tuple[int, _Found]]:
    """Return what was found in the order of the chunks, and as it was found in each."""
    return sorted(found, key=itemgetter(0))


def _loss(error: DamagedError, messages: int) -> Loss:
    return Loss(code=error.code, text=str(error), messages=messages)


def _merged(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Join spans that touch, in order."""
    merged: list[tuple[int, int]] = []
    for start, stop in sorted(spans):
        if merged and merged[-1][1] == start:
            merged[-1] = (merged[-1][0], stop)
        else:
            merged.append((start, stop))
    return merged

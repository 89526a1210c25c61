"""Messages that hold lists of samples: each element is one, at its own time or spread over the message's.

A driver that reads its sensor's buffer sends some samples at once. Where they carry no stamps of their own,
the message's is that of the last one, which was taken just before it was sent; the others lie before it, as
far apart as samples usually are: the median over all messages of the time since the message before, divided
by the number of its elements. So a message that is missing leaves a gap.
"""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from imucal.arrays import IntArray
from imucal.mapped import blocks
from imucal.readers.column_store import Columns
from imucal.readers.containers import Batch, Loss
from imucal.readers.files import DamagedError
from imucal.readers.messages.message_types import ImuFields
from imucal.readers.messages.tree_messages import (
    Parse,
    Steps,
    TreeDecoder,
    follow,
    messages_in,
    number_of,
    write_samples,
)


def tree_decoder(imu: ImuFields, parse: Parse = json.loads, kind: str = "JSON") -> TreeDecoder:
    """Return what decodes messages by their trees: a sample each, or one of each element."""
    return (ListDecoder if imu.lists else TreeDecoder)(imu, parse, kind)


class ListDecoder(TreeDecoder):
    """Decodes messages of which each element of a list is a sample."""

    def elements(self, batch: Batch, like: Columns) -> tuple[Columns, list[Loss]]:
        """Return the samples of some messages in columns of their own, and which messages were lost."""
        stamps: list[int] = []
        values: list[list[float]] = []
        warmth: list[float] = []
        log: list[int] = []
        losses = []
        for data, log_ns in zip(
            messages_in(batch), np.broadcast_to(batch.log_ns, batch.n).tolist(), strict=True
        ):
            try:
                times, rows, warm = self.parsed(data, self._samples)
            except DamagedError as error:
                losses.append(Loss(code=error.code, text=str(error), messages=1))
                continue
            stamps += times
            values += rows
            warmth += warm
            log += [log_ns] * len(rows)
        columns = like.like(len(log))
        columns.log[:] = log
        width = sum(len(vector.axes) for vector in self.imu.vectors)
        write_samples(
            columns,
            slice(0, len(log)),
            np.array(values, dtype=np.float64).reshape(-1, width),
            np.array(stamps, dtype=np.int64),
            np.array(warmth, dtype=np.float64),
        )
        return columns, losses

    def _samples(self, tree: Any) -> tuple[list[int], list[list[float]], list[float]]:  # noqa: ANN401 - any tree
        """Return the stamps, the numbers and the temperatures of the elements in a message."""
        columns = [_each(tree, steps) for paths in self.vectors for steps in paths]
        n = len(columns[0])
        if any(len(column) != n for column in columns):
            msg = f"lists of {', '.join(str(len(column)) for column in columns)} elements"
            raise ValueError(msg)
        rows = [[number_of(value) for value in row] for row in zip(*columns, strict=True)]
        warmth = [math.nan] * n
        if self.temperature:
            warmth = [number_of(value) for value in self._for_each(tree, self.temperature, n)]
        if not self.stamp:
            return [self.time_of(tree)] * n, rows, warmth
        parts = [self._for_each(tree, steps, n) for steps in self.stamp]
        return [self.ns_of(time) for time in zip(*parts, strict=True)], rows, warmth

    @staticmethod
    def _for_each(tree: Any, steps: Steps, n: int) -> list[Any]:  # noqa: ANN401 - any tree
        """Return what a path leads to in each of n elements, or n times what it leads to in the message."""
        return _each(tree, steps) if None in steps else [follow(tree, steps)] * n


def _each(tree: Any, steps: Steps) -> list[Any]:  # noqa: ANN401 - any tree
    """Return what a path leads to in each element of its list."""
    at = steps.index(None)
    return [follow(element, steps[at + 1 :]) for element in follow(tree, steps[:at])]


def spread_times(times: IntArray, messages: Sequence[IntArray]) -> None:
    """Put the elements of each message before its time, in ns, shape (n,), in place.

    Elements whose `messages`, shape (n,) each, are the same as those of the one before are of one message.
    """
    found = [_firsts(messages, part) for part in blocks(times.size, *messages)]
    firsts = np.concatenate([*found, [times.size]])
    counts = np.diff(firsts)
    if not np.any(counts > 1):
        return
    ends = times[firsts[:-1]]
    step = np.diff(ends) / counts[1:]
    forward = step[step > 0]
    if not forward.size:
        return
    tau = float(np.median(forward))
    for part in blocks(times.size, times):
        place = np.arange(part.start, part.stop)
        last = firsts[np.searchsorted(firsts, place, side="right")] - 1
        times[part] -= np.round((last - place) * tau).astype(np.int64)


def _firsts(messages: Sequence[IntArray], part: slice) -> IntArray:
    """Return the first elements of the messages that begin in a block."""
    before = max(part.start - 1, 0)
    new = np.zeros(part.stop - max(part.start, 1), dtype=np.bool_)
    for column in messages:
        new |= np.diff(column[before : part.stop]) != 0
    firsts = np.flatnonzero(new) + max(part.start, 1)
    return np.concatenate([[0], firsts]) if part.start == 0 else firsts

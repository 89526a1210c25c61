"""The loader: messages become rows, damage loses only the damaged messages, losses are reported."""

import time
from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucal.readers.containers import Batch, Loss, Task
from imucal.readers.files import DamagedError
from imucal.readers.messages import loader
from imucal.readers.messages.loader import Block, Decoding, Stream, decode

TYPES = [np.int64, np.float64]


def batch(values: Sequence[int], loss: Loss | None = None) -> Batch:
    """Return messages that contain only their log times."""
    starts = np.arange(len(values))
    return Batch(b"", starts, np.zeros_like(starts), np.array(values, np.int64), loss)


def task(
    batches: dict[int, Batch], damage: DamagedError | None = None, keys: Sequence[int] = (), wait_s: float = 0
) -> Task:
    """Return a chunk with some batches; `keys` adds channels that can't be read after them."""

    def load() -> Iterator[tuple[int, Batch]]:
        time.sleep(wait_s)
        yield from batches.items()
        if damage:
            raise damage

    return Task(10, frozenset([*batches, *keys]), load)


class Decoder:
    """Returns log times as samples; negative ones are damaged."""

    group = 2

    def __init__(self, code: str = "damaged") -> None:
        self.calls: list[int] = []
        self.code = code

    def decode(self, batch: Batch) -> Block:
        self.calls.append(batch.n)
        if (batch.log_ns < 0).any():
            msg = "bad"
            raise DamagedError(msg, code=self.code)
        return [batch.log_ns] * 3


def container(*tasks: Task, parallel: bool = False, counts: Sequence[int] = ()) -> Any:  # noqa: ANN401
    """Return a container with some tasks and message counts for channels from 1 on."""

    def wanted(keys: frozenset[int]) -> Iterator[Task]:
        return (task for task in tasks if keys & task.keys)

    channels = [SimpleNamespace(key=key, count=count) for key, count in enumerate(counts, start=1)]
    return SimpleNamespace(tasks=wanted, parallel=parallel, channels=channels, size=10**6)


def run(*tasks: Task, decoder: Decoder | None = None, count: int = 0) -> tuple[list[int], Decoding]:
    """Return the samples of channel 1 of one container, and the decoding."""
    stream = Stream(TYPES, {(0, 1): decoder or Decoder()})
    (found,) = decode([container(*tasks, counts=[count])], [stream])
    for values in found.columns:
        assert (values == found.columns[0]).all()
    return found.columns[0].tolist(), found


def test_chunks_are_concatenated_in_order() -> None:
    """Messages of other channels are ignored."""
    values, found = run(task({1: batch([1, 2]), 2: batch([9])}), task({2: batch([8])}), task({1: batch([3])}))
    assert (values, found.losses) == ([1, 2, 3], [])


def test_streams_and_files_are_kept_apart() -> None:
    """The same channel number means different channels in the two files."""
    files = [
        container(task({1: batch([1, 2]), 2: batch([5])})),
        container(task({1: batch([3]), 2: batch([6, 7])})),
    ]
    first = Stream(TYPES, {(0, 1): Decoder(), (1, 2): Decoder()})
    second = Stream(TYPES, {(0, 2): Decoder(), (1, 1): Decoder()})
    found = decode(files, [first, second])
    assert [decoding.columns[0].tolist() for decoding in found] == [[1, 2, 6, 7], [5, 3]]


def test_threads_do_not_change_the_result() -> None:
    """Rows keep the order of the file, and an error in a thread is raised."""
    tasks = [task({1: batch([10 * row, 10 * row + 1])}) for row in range(20)]
    seen: list[tuple[int, int]] = []
    (found,) = decode(
        [container(*tasks, parallel=True)],
        [Stream(TYPES, {(0, 1): Decoder()})],
        progress=lambda done, total: seen.append((done, total)),
    )
    assert found.columns[0].tolist() == [10 * row + more for row in range(20) for more in (0, 1)]
    assert seen == [(10 * (row + 1), 200) for row in range(20)]


def test_an_unreadable_chunk_loses_its_messages() -> None:
    """Channels loaded before the damage lose nothing. The file's message count gives the number lost."""
    error = DamagedError("gone", code="crc")
    damaged = task({2: batch([2])}, error, keys=[1])
    values, found = run(task({1: batch([1])}), damaged, task({1: batch([4, 5, -4])}), count=7)
    assert values == [1, 4, 5]
    assert found.losses == [Loss("crc", "gone", None), Loss("damaged", "bad", 1)]
    assert found.missing == 3
    values, found = run(task({1: batch([1])}, error), count=0)
    assert (values, found.losses, found.missing) == ([1], [], 0)


def test_without_counts_the_missing_messages_are_unknown() -> None:
    """One channel without a count is enough."""
    stream = Stream(TYPES, {(0, 1): Decoder(), (0, 2): Decoder()})
    (found,) = decode([container(task({1: batch([1])}), counts=[3, None])], [stream])  # type: ignore[list-item]
    assert (found.columns[0].size, found.missing) == (1, None)


@pytest.mark.parametrize("count", [0, 1, 10**15])
def test_a_wrong_count_changes_no_sample(count: int) -> None:
    """The count is a hint; the file's size limits the memory that is reserved."""
    values, _ = run(task({1: batch([1, 2])}), task({1: batch(range(3, 200_000))}), count=count)
    assert values == list(range(1, 200_000))


def test_the_group_of_a_damaged_message_is_lost() -> None:
    """A damaged batch is decoded once more, in groups; the messages of each lost group are counted."""
    decoder = Decoder()
    values, found = run(task({1: batch([1, 2, -3, 4, 5])}), decoder=decoder)
    assert values == [1, 2, 5]
    assert found.losses == [Loss(code="damaged", text="bad", messages=2)]
    assert decoder.calls == [5, 2, 2, 1]


@pytest.mark.parametrize("code", ["encapsulation", "definition"])
def test_messages_of_unknown_layout_are_all_lost(code: str) -> None:
    """An unknown layout is not retried in halves."""
    decoder = Decoder(code)
    values, found = run(task({1: batch([1, -2, 3])}), decoder=decoder)
    assert (values, decoder.calls) == ([], [3])
    assert found.losses == [Loss(code=code, text="bad", messages=3)]


def test_losses_do_not_depend_on_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Losses keep the order of the chunks, and the first ones are kept."""
    # The first of two neighbours takes longer.
    tasks = [task({1: batch([1])}), task({1: batch([81, 82])}, wait_s=0.03), task({1: batch([91, 92])})]
    for row in range(8):
        error = DamagedError(f"gone {row}", code="crc")
        tasks.append(task({2: batch([row])}, error, keys=[1], wait_s=0 if row % 2 else 0.03))
    monkeypatch.setattr(loader, "_MAX_LOSSES", 3)
    for threads in (1, 2, 4):
        monkeypatch.setattr(loader, "allowed_threads", lambda threads=threads: threads)
        (found,) = decode([container(*tasks, parallel=True)], [Stream(TYPES, {(0, 1): Decoder()})])
        assert found.columns[0].tolist() == [1, 81, 82, 91, 92]
        assert [loss.text for loss in found.losses] == ["gone 0", "gone 1", "gone 2"]


def test_losses_found_by_a_container_are_reported() -> None:
    loss = Loss(code="index", text="walked")
    values, found = run(task({1: batch([1, 2], loss)}), task({1: batch([5])}))
    assert (values, found.losses) == ([1, 2, 5], [loss])


def test_channels_without_messages_are_skipped() -> None:
    """The batch is empty, or the channel was not requested."""
    values, found = run(task({1: batch([])}), task({1: batch([3]), 2: batch([4])}))
    assert (values, found.losses) == ([3], [])
    (none,) = decode([container(task({1: batch([1])}))], [Stream(TYPES, {(1, 1): Decoder()})])
    assert none.columns[0].size == 0


def test_a_preview_reads_a_few_chunks_of_the_first_file_with_messages() -> None:
    """Without a limit all chunks of all files are read."""
    empty = container(task({2: batch([1])}))
    first = container(*(task({1: batch([row])}) for row in range(3)))
    second = container(task({1: batch([7])}))
    for most, expected in ((2, [0, 1]), (5, [0, 1, 2]), (None, [0, 1, 2, 7])):
        stream = Stream(TYPES, {(number, 1): Decoder() for number in range(3)})
        (found,) = decode([empty, first, second], [stream], most_chunks=most)
        assert found.columns[0].tolist() == expected


def test_the_number_of_kept_losses_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit of 1000 keeps a log of garbage from filling the memory."""
    assert loader._MAX_LOSSES == 1000
    monkeypatch.setattr(loader, "_MAX_LOSSES", 2)
    _, found = run(*(task({1: batch([-1])}) for _ in range(3)))
    assert len(found.losses) == 2

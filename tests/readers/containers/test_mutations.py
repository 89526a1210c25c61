"""Damaged logs give samples that were in the log, or are refused with a message."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from imucal.errors import ImucalError
from imucal.readers import describe, read
from imucal.readers.files import LogFile
from imucal.recording import Recording
from tests.readers.logs import CONTAINERS, Samples, samples
from tests.slow_cases import first_by_default

#: Cases of each format, in parts; more than 2000 in total.
CASES, PARTS = 80, 2
#: Largest number of adjacent bytes of one change.
LONGEST = 64
#: Least number of messages that one change may affect: a change of `LONGEST` bytes can touch two messages.
TOUCHED = 2 + LONGEST // 300
#: Largest number of bytes that reading and describing a log may read, in sizes of the log.
REPEATS = 20

FORMATS = tuple(CONTAINERS)
#: Number of samples that a change may falsify if there is no checksum: those with changed bytes, and in a
#: compressed block all that refer back to them. No reader can detect them.
STRANGE = {
    "bag-none": TOUCHED,
    "bag-lz4": 60,
    "db3": TOUCHED,
    "db3-file": 60,
    "db3-message": TOUCHED,
    "rosbag2-mcap": TOUCHED,
}
NAMES = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
Result = TypeVar("Result")


def flip(data: bytearray, rng: np.random.Generator) -> None:
    """Change single bits."""
    for _ in range(int(rng.integers(1, 4))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def cut(data: bytearray, rng: np.random.Generator) -> None:
    """Cut the end."""
    del data[int(rng.integers(len(data))) :]


def zero(data: bytearray, rng: np.random.Generator) -> None:
    """Fill a part with zeros."""
    at, size = int(rng.integers(len(data))), int(rng.integers(1, LONGEST))
    data[at : at + size] = bytes(min(size, len(data) - at))


def splice(data: bytearray, rng: np.random.Generator) -> None:
    """Copy a part of the file over another one, or remove it."""
    at, other, size = (int(rng.integers(len(data))) for _ in range(3))
    size = size % LONGEST + 1
    if rng.random() < 0.5:
        data[at : at + size] = data[other : other + size][: len(data) - at]
    else:
        del data[at : at + size]


CHANGES: tuple[Callable[[bytearray, np.random.Generator], None], ...] = (flip, cut, zero, splice)


@functools.cache
def truth() -> Samples:
    """Return the samples of all logs."""
    return samples(60)


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, bytes]]:
    """Return the file name and the bytes of a log of each format."""
    logs = {}
    for name in FORMATS:
        path = CONTAINERS[name](tmp_path_factory.mktemp(name), truth())
        file = next(f for f in path.iterdir() if f.suffix != ".yaml") if path.is_dir() else path
        logs[name] = (file.name, file.read_bytes())
    return logs


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("part", first_by_default(range(PARTS), 1))
def test_a_damaged_log_gives_original_samples_or_a_message(
    name: str,
    change: Callable[[bytearray, np.random.Generator], None],
    originals: dict[str, tuple[str, bytes]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    *,
    part: int,
) -> None:
    """Only imucal's own exceptions are allowed, and the bytes of a log are read a limited number of times.

    Messages are decoded alternately in this thread and in others, because threads are slow for few messages.
    """
    file, original = originals[name]
    rng = np.random.default_rng([FORMATS.index(name), CHANGES.index(change), part])
    sizes: list[int] = []
    read_bytes = LogFile._bytes

    def counted(file: LogFile, position: int, size: int) -> bytes:
        # An empty read counts too, so that a loop over them exceeds the limit.
        sizes.append(size + 1)
        return read_bytes(file, position, size)

    monkeypatch.setattr(LogFile, "_bytes", counted)
    known = [frozenset(column) for column in truth().all.T.tolist()]
    for case in range(part, CASES // len(CHANGES), PARTS):
        data = bytearray(original)
        change(data, rng)
        path = tmp_path / f"{case}-{file}"
        path.write_bytes(data)
        monkeypatch.setenv("IMUCAL_THREADS", "2" if case % 4 == 0 else "1")
        sizes.clear()
        recording, message = _outcome(read, path)
        assert recording is not None or message.startswith(str(path))
        if recording is not None:
            assert _strange(recording, known) <= STRANGE.get(name, 0), f"case {case}"
            assert max(series.n for series in recording.series) <= truth().stamps.size + TOUCHED
        contents, message = _outcome(describe, path)
        assert contents is not None or message.startswith(str(path))
        assert sum(sizes) <= REPEATS * len(data), f"case {case}"
        path.unlink()


def _outcome(action: Callable[[Path], Result], path: Path) -> tuple[Result | None, str]:
    """Return a result, or the message of imucal's own error; any other exception fails the test."""
    try:
        return action(path), ""
    except ImucalError as error:
        return None, str(error)


def _strange(recording: Recording, known: list[frozenset[float]]) -> int:
    """Return the largest number of samples of an axis that were never written."""
    columns = dict(zip(NAMES, known, strict=True))
    return max(
        sum(value not in columns[series.name] for value in series.samples.tolist())
        for series in recording.series
    )

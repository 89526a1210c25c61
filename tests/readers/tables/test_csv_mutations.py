"""Damaged texts cause no traceback, no endless loop, and no value that the text does not contain."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imucal.errors import ImucalError
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.readers.tables import text_source
from tests.readers.tables.texts import STYLES, Style, write
from tests.slow_cases import first_by_default

#: Every layout is damaged by every kind of damage with this many seeds, in this many parts.
SEEDS, PARTS = 12, 2
LAYOUTS = (
    "EuRoC",
    "rostopic echo -p",
    "phyphox decimal comma",
    "Xsens MT Manager",
    "ustime",
    "tagged rows",
    "JSON lines",
    "JSON lines of sensors",
)
#: Lines of a log: enough for several blocks of the test's block size.
LINES = 160

Damage = Callable[[bytes, np.random.Generator], bytes]

_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?|nan|inf(?:inity)?", re.IGNORECASE)


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    """Change some bits."""
    damaged = bytearray(data)
    for place in rng.integers(0, len(data), 1 + int(rng.integers(0, 12))):
        damaged[place] ^= 1 << int(rng.integers(0, 8))
    return bytes(damaged)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """Cut the end off."""
    return data[: int(rng.integers(0, len(data)))]


def zero(data: bytes, rng: np.random.Generator) -> bytes:
    """Fill a part with zeros, as a crash does."""
    start, size = int(rng.integers(0, len(data))), int(rng.integers(1, 5000))
    return data[:start] + bytes(min(size, len(data) - start)) + data[start + size :]


def splice(data: bytes, rng: np.random.Generator) -> bytes:
    """Insert a copy of one part at another place."""
    start, place = (int(value) for value in rng.integers(0, len(data), 2))
    return data[:place] + data[start : start + int(rng.integers(1, 5000))] + data[place:]


def drop(data: bytes, rng: np.random.Generator) -> bytes:
    """Remove a part."""
    start = int(rng.integers(0, len(data)))
    return data[:start] + data[start + int(rng.integers(1, 3000)) :]


def strange_values(values: set[float], data: bytes) -> set[float]:
    """Return the values that are neither a cell of the text nor a number within its longer digits."""
    text_source = data.decode("latin-1")
    strange = values - _numbers(re.split(r"[,;\t\s*\"$|]+", text_source))
    return strange - _numbers(_NUMBER.findall(text_source)) if strange else strange


def _numbers(cells: list[str]) -> set[float]:
    numbers = set()
    for cell in cells:
        try:
            numbers.add(float(cell.replace(",", ".").replace("_", "x")))
        except ValueError:
            continue
    return numbers


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Style, bytes]]:
    """Return the first lines of each layout, written once."""
    folder = tmp_path_factory.mktemp("logs")
    chosen = [style for style in STYLES if style.name in LAYOUTS]
    complete = {style.name: (style, write(style, folder).read_bytes()) for style in chosen}
    return {
        name: (style, b"".join(data.splitlines(keepends=True)[:LINES]))
        for name, (style, data) in complete.items()
    }


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("damage", [flip, cut, zero, splice, drop])
@pytest.mark.parametrize("part", first_by_default(range(PARTS), 1))
def test_a_damaged_text_is_read_or_refused_with_a_message(
    name: str,
    damage: Damage,
    logs: dict[str, tuple[Style, bytes]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    *,
    part: int,
) -> None:
    """Every sample must be a number of the damaged text."""
    style, data = logs[name]
    monkeypatch.setattr(text_source, "_HEAD", 2048)
    monkeypatch.setattr(text_source, "_BLOCK", 4096)
    path = tmp_path / style.file
    # SI units are given so that every sample is a number of the text.
    options = ReadOptions(
        gyro_unit="rad/s",
        accel_unit="m/s^2",
        columns=style.options.get("columns"),  # type: ignore[arg-type]
    )
    for seed in range(part, SEEDS, PARTS):
        rng = np.random.default_rng([seed, LAYOUTS.index(name)])
        damaged = damage(data, rng)
        path.write_bytes(damaged)
        try:
            recording = read(path, options)
        except ImucalError as error:
            assert str(path) in str(error), f"seed {seed}: {error}"  # noqa: PT017 - the message is the point
            continue
        points = damaged.replace(b",", b".") if b";" in damaged[:60] else damaged
        samples = np.concatenate([series.samples for series in recording.series])
        strange = strange_values(set(samples[np.isfinite(samples)].tolist()), points)
        assert not strange, f"seed {seed}: {sorted(strange)[:3]} stand nowhere in the text"
        for series in recording.series:
            assert math.isfinite(series.rate_hz)
            assert series.clock.n == series.n


@pytest.mark.parametrize("damage", [flip, cut, zero, splice, drop])
def test_a_damaged_zip_is_read_or_refused_with_a_message(damage: Damage, tmp_path: Path) -> None:
    style = next(style for style in STYLES if style.name == "phyphox zip")
    path = write(style, tmp_path)
    data = path.read_bytes()
    for seed in range(SEEDS):
        path.write_bytes(damage(data, np.random.default_rng(seed)))
        try:
            recording = read(path, ReadOptions())
        except ImucalError as error:
            assert str(path) in str(error), f"seed {seed}: {error}"  # noqa: PT017 - the message is the point
        else:
            assert recording.series

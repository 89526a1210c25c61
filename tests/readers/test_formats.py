"""Requirements for every format: the interface of its module, and detection of files."""

import importlib
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from inspect import get_annotations
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from imucal.errors import ReadError
from imucal.readers import FORMATS, describe, read
from imucal.readers.containers import Container
from imucal.readers.formats import Format, detect, load_opener
from tests.raising import raises
from tests.readers.logs import CONTAINERS, samples

#: Formats of messages, as documented in `imucal.recording.Source`.
SOURCE_FORMATS = {
    "mcap",
    "rosbag1",
    "rosbag2-sqlite3",
    "rosbag2-mcap",
}


ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Return the names of the formats of the logs in `CONTAINERS`."""
    folders = [(tmp_path_factory.mktemp("log"), write) for write in CONTAINERS.values()]
    return {detect(write(folder, samples(2))).name for folder, write in folders}


def missing(entry: Format, written: set[str]) -> list[str]:
    """Return a sentence for each part that a format lacks."""
    sentences = [*_missing_in_table(entry), *_missing_in_module(entry)]
    rows = re.findall(r"^\| ([^|]+) \|", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    if not any(re.search(rf"\b{re.escape(entry.name)}\b", row, re.IGNORECASE) for row in rows):
        sentences.append("README.md has no row for it in its table of formats.")
    if entry.messages and entry.name not in written:
        sentences.append("tests/readers/logs.py has no writer of such a log in CONTAINERS.")
    return [f"{entry.name}: {sentence}" for sentence in sentences]


def _missing_in_table(entry: Format) -> Iterator[str]:
    if not entry.magic and not entry.suffixes:
        yield "it has neither first bytes nor an ending, so no file is ever taken for it."
    for other in FORMATS:
        shared = [a for a in entry.magic for b in other.magic if a.startswith(b) or b.startswith(a)]
        if shared and other.name != entry.name:
            yield f"its first bytes {shared[0]!r} are those of {other.name} too."
    if entry != FORMATS[-1] and not entry.magic:
        yield "only the last format may do without first bytes: it takes all text."


def _missing_in_module(entry: Format) -> Iterator[str]:
    try:
        module = importlib.import_module(entry.module)
    except ModuleNotFoundError:
        yield f"there is no module {entry.module}."
        return
    if not module.__doc__:
        yield f"{entry.module} has no docstring."
    for name in ("open_files",) if entry.messages else ("open_log",):
        function = getattr(module, name, None)
        if function is None:
            yield f"{entry.module} has no function {name}."
        elif not function.__doc__:
            yield f"{entry.module}.{name} has no docstring."


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_a_format_is_complete(entry: Format, written: set[str]) -> None:
    """A format needs a module, functions, docstrings, first bytes, a row in the README, and a test log."""
    assert missing(entry, written) == []


def test_missing_parts_of_a_format_are_reported(written: set[str], monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("imucal_test_gadget")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    entry = Format(name="Gadget bag", supported="all", module=module.__name__, messages=True)
    assert missing(entry, written) == [
        "Gadget bag: it has neither first bytes nor an ending, so no file is ever taken for it.",
        "Gadget bag: only the last format may do without first bytes: it takes all text.",
        "Gadget bag: imucal_test_gadget has no docstring.",
        "Gadget bag: imucal_test_gadget has no function open_files.",
        "Gadget bag: README.md has no row for it in its table of formats.",
        "Gadget bag: tests/readers/logs.py has no writer of such a log in CONTAINERS.",
    ]
    table = replace(entry, module="imucal.nowhere", magic=(b"\x89MCAP",), messages=False)
    assert missing(table, written)[:2] == [
        "Gadget bag: its first bytes b'\\x89MCAP' are those of MCAP too.",
        "Gadget bag: there is no module imucal.nowhere.",
    ]


def lacks(container: object) -> list[str]:
    """Return a sentence for each member of the protocol `Container` that a container lacks."""
    name = type(container).__name__
    members = [*get_annotations(Container), "tasks", "close"]
    return [f"{name} has no {member}." for member in members if not hasattr(container, member)]


@pytest.mark.parametrize("name", CONTAINERS)
def test_every_container_has_the_interface_that_readers_use(name: str, tmp_path: Path) -> None:
    path = CONTAINERS[name](tmp_path, samples(20))
    opened, form = load_opener(detect(path))(path, None)
    for container in opened:
        assert lacks(container) == []
        container.close()
    assert form in SOURCE_FORMATS


def test_missing_parts_of_a_container_are_reported() -> None:
    """The container has only a path."""
    assert lacks(SimpleNamespace(path=Path("log"), tasks=None)) == [
        f"SimpleNamespace has no {member}."
        for member in [
            "format",
            "compression",
            "size",
            "channels",
            "findings",
            "start_ns",
            "end_ns",
            "parallel",
            "close",
        ]
    ]


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_every_format_refuses_a_file_with_only_its_signature(entry: Format, tmp_path: Path) -> None:
    """Random bytes follow the signature; the error starts with the path."""
    for number, magic in enumerate(entry.magic or (b"a,b\n",)):
        path = tmp_path / f"{number}{entry.suffixes[0]}"
        path.write_bytes(magic + bytes(range(256)) * 4)
        if entry.magic:
            assert detect(path) == entry
        with pytest.raises(ReadError) as caught:
            read(path)
        assert str(caught.value).startswith(str(path))
        try:
            assert not describe(path).imu_topics
        except ReadError as error:
            assert str(error).startswith(str(path))  # noqa: PT017 - one of two ways to say it


def test_the_first_bytes_override_the_extension(tmp_path: Path) -> None:
    """A bag with the extension .txt is a bag."""
    path = tmp_path / "log.txt"
    path.write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    assert detect(path).name == "ROS 1 bag"
    path.write_text("a,b\n1,2\n", encoding="utf-8")
    assert detect(path).name == "text"


def test_reading_without_a_path_is_an_error() -> None:
    with pytest.raises(ValueError, match="no log: name at least one file"):
        read()


@pytest.mark.parametrize(
    ("name", "head", "expected"),
    [
        # A text never has this extension, so the first bytes of the log are lost.
        ("log.mcap", b"text", "MCAP"),
        ("log.bag", b"text", "ROS 1 bag"),
        ("log.BAG.active", b"text", "ROS 1 bag"),
        ("log.db3", b"text", "text"),
        ("log.ulg", b"text", "text"),
        ("log.npz", b"text", "text"),
        ("log", b"text", "text"),
        ("log.ulg", b"\x00\x01", "PX4 ULog"),
        ("log.ulg", b"\xff\xfet\x00", "text"),
        ("log.db3.zstd", b"\x28\xb5\x2f\xfd", "ROS 2 bag"),
        ("log.csv", b"\x1f\x8b\x00", "text"),
        ("log.unknown", b"PK\x03\x04\x00", "text"),
    ],
)
def test_the_extension_decides_without_a_signature(
    name: str, head: bytes, expected: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(head)
    assert detect(tmp_path / name).name == expected


def test_binary_data_with_an_unknown_extension_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.xyz"
    path.write_bytes(bytes(range(20)))
    with pytest.raises(ReadError) as error:
        detect(path)
    assert str(error.value).startswith(
        f"{path}: binary data of an unknown format (first bytes 00 01 02 03 04 05 06 07); "
        "expected one of .mcap, .bag, .bag.active, .db3, "
    )


def test_a_device_is_refused(tmp_path: Path) -> None:
    """/dev/zero has no end."""
    path = tmp_path / "log.mcap"
    path.symlink_to("/dev/zero")
    with raises(ReadError, "a device", place="log.mcap"):
        detect(path)

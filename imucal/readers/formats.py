"""The table of formats: first bytes of a file -> module that reads it."""

import importlib
import stat
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Protocol, cast

from imucal.errors import ReadError
from imucal.readers.containers import Container
from imucal.readers.containers.rosbag2_folder import METADATA, natural
from imucal.readers.contents import LogContents
from imucal.readers.files import first_bytes
from imucal.readers.read_options import Progress, ReadOptions
from imucal.readers.ways_out import way_out
from imucal.recording import Recording

#: The name that stands for standard input.
STDIN = "-"

#: Bytes that tell a format, from the start of a file.
_HEAD = 4096

_CONTAINERS = "imucal.readers.containers"
_COMPRESSED = (b"\x28\xb5\x2f\xfd", b"\x1f\x8b", b"BZh", b"\xfd7zXZ\x00", b"PK\x03\x04", b"\x04\x22\x4d\x18")
_BYTE_ORDER_MARKS = (b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf")


class Opener(Protocol):
    """What the module of a format of messages offers."""

    def open_files(self, path: Path, progress: Progress | None = None) -> tuple[list[Container], str]:
        """Open the files of a log; also return the name of their format."""


class Reader(Protocol):
    """What the module of any other format offers."""

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Return the samples."""

    def describe(self, path: Path, options: ReadOptions) -> LogContents:
        """Return what is in the log."""


@dataclass(frozen=True, slots=True)
class Format:
    """A format.

    Attributes
    ----------
    name
        As docs/formats.md calls it.
    module
        What reads it: a module with `read` and `describe`, or with `open_files` where `messages` is true.
    magic, suffixes
        The first bytes, and the endings that its files usually have.
    messages
        Whether its files are containers of messages, which `imucal.readers.message_logs` reads.
    damaged_start
        Whether a file of that ending which looks like text is one whose first bytes are damaged.
    folders
        Whether folders are of this format, unless they hold tables.
    """

    name: str
    module: str
    magic: tuple[bytes, ...] = ()
    suffixes: tuple[str, ...] = ()
    _: KW_ONLY
    messages: bool = False
    damaged_start: bool = False
    folders: bool = False


#: In the order in which they are tried; the last one takes all text.
FORMATS: tuple[Format, ...] = (
    Format("MCAP", f"{_CONTAINERS}.mcap", (b"\x89MCAP0\r\n",), (".mcap",), messages=True, damaged_start=True),
    Format(
        "ROS 1 bag",
        f"{_CONTAINERS}.ros1",
        (b"#ROSBAG V",),
        (".bag", ".bag.active"),
        messages=True,
        damaged_start=True,
    ),
    Format(
        "ROS 2 bag",
        f"{_CONTAINERS}.ros2_bag",
        (b"SQLite format 3\x00",),
        (".db3", ".db3.zstd", ".mcap.zstd"),
        messages=True,
        folders=True,
    ),
    Format("PX4 ULog", "imucal.readers.flight_logs", (b"ULog\x01\x12\x35",), (".ulg",)),
    Format("ArduPilot log", "imucal.readers.flight_logs", (b"\xa3\x95\x80\x80",), (".bin", ".tlog")),
    Format(
        "Parquet, HDF5, NPZ, NPY, MATLAB",
        "imucal.readers.tables.typed_table",
        (b"PAR1", b"\x93NUMPY", b"MATLAB 5.0 MAT-file", b"MATLAB 7.3", b"\x89HDF\r\n\x1a\n"),
        (".parquet", ".h5", ".hdf5", ".npz", ".npy", ".mat"),
    ),
    Format(
        "text", "imucal.readers.tables.text_table", (), (".csv", ".tsv", ".txt", ".log", ".dat", ".jsonl")
    ),
)


def detect(path: Path) -> Format:
    """Return the format of a file, by its first bytes; its ending decides only where they say nothing.

    Raises
    ------
    ReadError
        If there is no such file, it can't be opened, is empty, or is none of the formats.
    """
    text = FORMATS[-1]
    if str(path) == STDIN:
        return text
    if is_folder(path):
        return text if _holds_tables(path) else next(e for e in FORMATS if e.folders)
    with suppress(OSError):
        if stat.S_ISFIFO(path.stat().st_mode):
            msg = f"{path}: a pipe can be read only once; expected a file, or - with text on standard input"
            raise ReadError(msg)
    head = first_bytes(path, _HEAD)
    if not head:
        msg = f"{path}: the file is empty; expected a log"
        raise ReadError(msg)
    return detect_head(path, head)


def detect_head(path: Path, head: bytes) -> Format:
    """Return the format of a file by its first bytes; its name decides only where they say nothing.

    Raises
    ------
    ReadError
        If it is none of the formats.
    """
    way = way_out(str(path), head)
    if way:
        msg = f"{path}: {way}"
        raise ReadError(msg)
    # `startswith` is false of no magic at all.
    by_magic = next((entry for entry in FORMATS if head.startswith(entry.magic)), None)
    return by_magic or _by_ending(path, head)


def _by_ending(path: Path, head: bytes) -> Format:
    """Return the format of a file whose first bytes say only whether it is text, compressed or binary."""
    text = FORMATS[-1]
    name = path.name.lower()
    ending = next((entry for entry in FORMATS if name.endswith(entry.suffixes)), text)
    if head.startswith(_COMPRESSED):
        return ending
    if b"\x00" not in head or head.startswith(_BYTE_ORDER_MARKS):
        # A damaged binary log may have lost its first bytes; text never ends in .mcap.
        return ending if ending.damaged_start else text
    # Anybody's binary data may end in .bin; ArduPilot's begin with their mark.
    if ending is text or name.endswith(".bin"):
        # Text of two bytes a letter may have no mark that says so.
        from imucal.readers.tables.text_source import utf16_order

        if utf16_order(head) is not None:
            return text
        known = ", ".join(suffix for entry in FORMATS for suffix in entry.suffixes)
        start = head[:8].hex(" ")
        msg = (
            f"{path}: binary data of an unknown format (first bytes {start}); expected one of {known}; "
            "export a device's own format as CSV with its maker's program"
        )
        raise ReadError(msg)
    return ending


def load(entry: Format) -> Reader:
    """Import the module of a format."""
    if not entry.messages:
        return cast("Reader", importlib.import_module(entry.module))
    from imucal.readers.message_logs import MessageReader

    return MessageReader(load_opener(entry).open_files)


def load_opener(entry: Format) -> Opener:
    """Import the module of a format of messages."""
    return cast("Opener", importlib.import_module(entry.module))


def logs_of(path: Path) -> list[Path]:
    """Return the logs that a path stands for: itself, or each of a folder of logs that is no bag.

    A bag has a ``metadata.yaml``, which says that its files are one recording; logs of messages that
    stand together without it may be anything. They are in the natural order of their names.
    """
    if str(path) == STDIN or not is_folder(path) or (path / METADATA).exists():
        return [path]
    endings = tuple(suffix for entry in FORMATS if entry.messages for suffix in entry.suffixes)
    logs = sorted((entry for entry in path.iterdir() if entry.name.endswith(endings)), key=natural)
    return logs if len(logs) > 1 or any(log.suffix == ".bag" for log in logs) else [path]


def is_folder(path: Path) -> bool:
    """Return whether a path is a folder; one with a name longer than there can be is none."""
    try:
        return path.is_dir()
    except OSError:
        return False


def _holds_tables(folder: Path) -> bool:
    """Return whether a folder is an app's set of text tables, and not a bag."""
    names = [entry.name.lower() for entry in folder.iterdir()]
    bag = any(name == "metadata.yaml" or ".db3" in name or ".mcap" in name for name in names)
    return not bag and any(name.endswith(FORMATS[-1].suffixes) for name in names)

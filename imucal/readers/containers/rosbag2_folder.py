"""The folder of a ROS 2 bag: which files it has, in which order, and what its metadata say."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from imucal.errors import ReadError

#: Endings of the files of a bag.
ENDINGS = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd", ".mcap.zst", ".db3.zst")

#: The file that makes a folder a bag.
METADATA = "metadata.yaml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Folder:
    """A bag's files, in order, and what the metadata say of them."""

    #: Those that exist, in the order of the recording.
    files: tuple[Path, ...]
    #: Names of files that the metadata list and the folder lacks.
    missing: tuple[str, ...] = ()
    #: Whether each message is compressed on its own.
    per_message: bool = False
    #: Topic -> messages in all files; None where the metadata don't say.
    counts: dict[str, int] | None = field(default=None)


def open_folder(path: Path) -> Folder:
    """Return the files of a bag; raises ReadError if the folder holds none."""
    return folder_of(path, [entry.name for entry in path.iterdir()], _metadata(path / METADATA))


def folder_of(path: Path, inside: Sequence[str], metadata: str) -> Folder:
    """Return the files of a bag, by the names in its folder and the text of its metadata, which may be empty.

    Raises ReadError if the folder holds none.
    """
    present = {name: path / name for name in inside if name.endswith(ENDINGS)}
    names, mode, counts = parse_metadata(metadata)
    files = {name: _present(present, name) for name in names}
    found = tuple(file for file in files.values() if file is not None)
    missing = tuple(name for name, file in files.items() if file is None)
    if not found:
        found = tuple(sorted(present.values(), key=natural))
        counts = None
    if not found:
        found_names = ", ".join(sorted(inside)[:10]) or "nothing"
        msg = f"{path}: not the folder of a ROS 2 bag: it holds {found_names}; expected .mcap or .db3 files"
        raise ReadError(msg)
    per_message = mode.upper() == "MESSAGE"
    return Folder(files=found, missing=missing, per_message=per_message, counts=None if missing else counts)


def _metadata(path: Path) -> str:
    """Return the text of the metadata; nothing where there are none."""
    if not path.exists():
        return ""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        msg = f"{path}: can't be read: {error.strerror or error}"
        raise ReadError(msg) from error


def parse_metadata(text: str) -> tuple[tuple[str, ...], str, dict[str, int] | None]:
    """Return relative paths, compression mode and messages of each topic.

    The few lines that matter are found by their keys: a YAML parser is not worth a dependency here.
    """
    paths = re.search(r"^\s*relative_file_paths:\s*\n((?:\s*-\s.*\n?)+)", text, re.MULTILINE)
    names = tuple(_unquoted(line.split("-", 1)[1]) for line in paths[1].splitlines()) if paths else ()
    mode = re.search(r"^\s*compression_mode:[ \t]*(.*)$", text, re.MULTILINE)
    topics = text.partition("topics_with_message_count:")[2]
    counts: dict[str, int] = {}
    name: str | None = None
    count: int | None = None
    for key, value in re.findall(r"^[ \t-]*(name|message_count):[ \t]*(.*)$", topics, re.MULTILINE):
        if key == "name":
            name = _unquoted(value)
        elif value.strip().isdigit():
            count = int(value)
        if name is not None and count is not None:
            counts[name] = count
            name = count = None
    return names, _unquoted(mode[1]) if mode else "", counts or None


def natural(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Return a key that sorts bag_2 before bag_10."""
    parts = re.split(r"(\d+)", path.name)
    return tuple((1, int(part), "") if part.isdigit() else (0, 0, part) for part in parts)


def _present(present: dict[str, Path], name: str) -> Path | None:
    """Return the file of a name, which may have been unpacked or packed since the metadata were written."""
    base = Path(name).name
    names = (base, base + ".zstd", base + ".zst", re.sub(r"\.zstd?$", "", base))
    return next((present[other] for other in names if other in present), None)


def _unquoted(value: str) -> str:
    return value.strip().strip("'\"")

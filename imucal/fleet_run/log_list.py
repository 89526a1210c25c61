"""What a person names -> logs: files, folders of any depth, wildcards, and a list on standard input."""

import glob
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from imucal.errors import ReadError
from imucal.readers import FORMATS
from imucal.readers.containers.rosbag2_folder import METADATA, natural
from imucal.readers.formats import STDIN
from imucal.remote import expand, is_url
from imucal.remote.addresses import has_wildcards, name_of

#: Endings that files have which are no logs: a folder's files of these are not taken unless they are named.
_VAGUE = (".txt", ".log", ".dat")
#: What compressed tables and logs end in besides.
_PACKED = ("", ".gz", ".bz2", ".xz", ".zst", ".zstd", ".zip", ".lz4")
_ENDINGS = tuple(
    ending + packed
    for form in FORMATS
    for ending in form.suffixes
    for packed in _PACKED
    if ending not in _VAGUE
)


def find_logs(names: Iterable[str], listed: Iterable[str] = ()) -> list[str]:
    """Return the logs that some names stand for, each once, in the order of the names.

    Parameters
    ----------
    names
        Files, folders, URLs, names with wildcards (``*``, ``?``, ``[…]``, and ``**`` for folders of any
        depth), or ``-`` for `listed`.
    listed
        Lines of a list, one name each; empty ones are left out.

    Raises
    ------
    ReadError
        If wildcards match nothing, a folder holds no log, or a name is neither a file nor a log's.
    """
    found: dict[str, None] = {}
    for name in names:
        several = (line.strip() for line in listed) if name == STDIN else (name,)
        for one in several:
            if one:
                found |= dict.fromkeys(_logs_of(one))
    return list(found)


def _logs_of(name: str) -> list[str]:
    if is_url(name):
        # What is called as a log is taken as one: a store is not asked for each of a million.
        plain = not has_wildcards(name) and name_of(name).lower().endswith(_ENDINGS)
        return [name] if plain else expand(name)
    if os.path.isdir(name):  # noqa: PTH112 - a name stays as it was typed
        return _in_folder(name)
    if os.path.lexists(name):
        return [name]
    if not glob.has_magic(name):
        if name.lower().endswith(_ENDINGS):
            # A log that is missing is one that can't be read, as any other.
            return [name]
        msg = f"{name}: no such file or folder; expected logs, or folders with logs in them"
        raise ReadError(msg)
    found = glob.glob(name.removesuffix("**"), recursive=True)  # noqa: PTH207 - as it was typed
    matches = sorted(found, key=lambda match: [natural(Path(part)) for part in Path(match).parts])
    suffix = Path(name).suffix
    # Of *.txt all are meant; of a bare star only what can be a log.
    endings = ("",) if suffix and not glob.has_magic(suffix) else _ENDINGS
    logs = [log for match in matches for log in _of_match(match, endings)]
    if not logs:
        msg = f"{name}: no log has such a name; expected files, or folders with logs in them"
        raise ReadError(msg)
    return logs


def _of_match(match: str, endings: tuple[str, ...]) -> list[str]:
    if os.path.isdir(match):  # noqa: PTH112 - a name stays as it was typed
        return list(_walk(match))
    return [match] if match.lower().endswith(endings) else []


def _in_folder(folder: str) -> list[str]:
    logs = list(_walk(folder))
    if not logs:
        msg = f"{folder}: no log in this folder; expected files that end in .mcap, .bag, .db3, .csv or others"
        raise ReadError(msg)
    return logs


def _walk(folder: str) -> Iterator[str]:
    """Yield the logs in a folder: bags, which are folders, and files by their endings."""
    if os.path.exists(os.path.join(folder, METADATA)):  # noqa: PTH110, PTH118 - a name stays as it was typed
        yield folder
        return
    for entry in sorted(Path(folder).iterdir(), key=natural):
        name = os.path.join(folder, entry.name)  # noqa: PTH118
        if entry.name.startswith("."):
            continue
        if entry.is_dir():
            yield from _walk(name)
        elif entry.name.lower().endswith(_ENDINGS):
            yield name

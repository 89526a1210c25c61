"""Definitions of message types in the user's own `.msg` files, as packages hold them, or in their folders."""

import re
from collections.abc import Sequence
from pathlib import Path

from imucal.errors import ReadError
from imucal.readers.messages.definitions import plain_type

#: A folder with more files is none of message definitions.
_MANY = 20_000


def read_definitions(paths: Sequence[Path]) -> dict[str, str]:
    """Return the definitions in files and folders: ``package/Name`` -> text.

    The name is that of the file; the package that of the folder above ``msg/``, and empty elsewhere.

    Raises
    ------
    ReadError
        If a file can't be read, or there is none in a folder.
    """
    found = {}
    for path in paths:
        files = sorted(path.rglob("*.msg"))[:_MANY] if path.is_dir() else [path]
        if not files:
            msg = f"{path}: no .msg files in this folder; expected the definitions of message types"
            raise ReadError(msg)
        for file in files:
            try:
                text = file.read_text(encoding="utf-8-sig")
            except (OSError, UnicodeDecodeError) as error:
                msg = f"{file}: can't be read: {error}; expected a message definition"
                raise ReadError(msg) from error
            folder = file.resolve().parent
            package = folder.parent.name if folder.name == "msg" else ""
            found[f"{package}/{_stem(file)}"] = text
    return found


def _stem(file: Path) -> str:
    """Return the name of the type that a file defines; packages and versions may stand in its name."""
    return re.split(r"[/.]|__", file.name.removesuffix(".msg"))[-1]


def definition_of(kind: str, given: dict[str, str]) -> str | None:
    """Return the given definition of a type; None where none of that name is given.

    One of its package goes first; one of another package is none, one of no package is.
    """
    name = plain_type(kind)
    return given.get(name, given.get("/" + name.rpartition("/")[2]))

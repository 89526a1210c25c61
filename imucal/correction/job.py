"""What all formats need to rewrite a file: the messages to change, and the mark of a corrected log."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from imucal._version import __version__
from imucal.readers.containers.container import Batch

#: Name of the mark: a metadata record of MCAP, a field of ROS 1 connections, a table of SQLite, the ending of
#: a file next to a text.
MARK = "imucal-corrected"

#: Changes the messages of a batch, whose buffer is mutable; the first argument is the channel.
Patch: TypeAlias = Callable[[int, Batch], None]


class AlreadyCorrectedError(Exception):
    """A log has the mark: correcting it again would remove bias and scale twice."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """The rewriting of a file.

    The messages of the channels `keys` are changed by `patch`. `mark` is the text of the mark, and `progress`
    gets the bytes read so far.
    """

    keys: frozenset[int]
    patch: Patch
    mark: str
    progress: Callable[[int], None]


def mark_file(path: Path) -> Path:
    """Return the file that marks a corrected text table, which has no place for a mark itself."""
    return path.with_name(f"{path.name}.{MARK}")


def mark_text(calibration: str) -> str:
    """Return the text of the mark."""
    return f"by imucal {__version__}, calibration {calibration}"

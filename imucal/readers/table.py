"""What every file becomes: tables of named columns, whose samples are read on request."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.errors import Fix
from imucal.findings import Finding
from imucal.readers.tables.dialects import Dialect
from imucal.readers.tables.layout import Rows
from imucal.readers.tables.stamps import TimeChoice
from imucal.recording import LogFileInfo

#: First values of a column: an array, or the cells of a text.
Head: TypeAlias = NDArray[Any] | Sequence[str]

#: Rows of a table by which names, units and kinds of columns are judged.
HEAD_ROWS = 400
#: Unit of a column of complete time stamps.
STAMPS = "ns"


def cells_of(head: Head) -> list[str]:
    """Return first values as text; a column without values counts as zero."""
    if not isinstance(head, np.ndarray):
        return list(head)
    values = head[:HEAD_ROWS].tolist()
    return ["" if value is None or value != value else str(value) for value in values] or ["0"]  # noqa: PLR0124 - NaN


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of a table."""

    name: str
    #: In the log, such as ``float64``; empty in a text.
    type: str = ""
    #: Unit in the file, or `STAMPS`; None if it has none.
    unit: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns with one row per sample: a topic, a message of a flight log, a file, arrays of one length."""

    #: Topic, instance (``sensor_combined``), or name of the file.
    name: str
    #: Another name by which users may choose it; empty if it has none.
    alias: str = ""
    #: Message type, or ``table``.
    kind: str
    #: Place in messages: the path of a file, or ``topic /imu``.
    place: str
    columns: tuple[Column, ...]
    #: Returns the first values of each column, at most `HEAD_ROWS` of a text; empty for columns that are not
    #: examined.
    head: Callable[[], Sequence[Head]]
    #: Whether messages of one type fill it, so that its name and its type tell what it contains.
    is_topic: bool = False
    #: Whether it is one of several files, so that its name tells its sensor.
    is_member: bool = False
    #: Index of the column of recording times, which only messages have; it is not in `columns`.
    log_time: int | None = None
    #: None if counting requires reading all of them.
    count: int | None = None
    #: Times of the first and last row, in ns; None if unknown.
    first_ns: int | None = None
    last_ns: int | None = None
    #: Sampling rate in the file, in Hz.
    rate_hz: float | None = None
    #: None if the names of the columns decide.
    dialect: Dialect | None = None
    #: Lines above the header.
    preamble: Sequence[str] = ()
    #: Whether rows without values belong to other sensors.
    sparse: bool = False
    #: Whether it is read only if the user names it.
    weak: bool = False
    #: Why it can't be read, and what helps; otherwise empty.
    reason: str = ""
    fixes: tuple[Fix, ...] = ()
    #: Why its columns can't be chosen by name; otherwise empty.
    unnamed: str = ""
    #: Numbers in a message, such as ``gyro_x float32``, and shapes of arrays, for messages.
    fields: tuple[str, ...] = ()
    shapes: str = ""
    #: Returns the frame in the first message; empty if there is none.
    frame: Callable[[], str] = str

    @property
    def duration_s(self) -> float | None:
        if self.first_ns is None or self.last_ns is None:
            return None
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def measured_hz(self) -> float | None:
        """Rate of the rows; None if it is unknown."""
        duration = self.duration_s
        if not self.count or self.count < 2 or not duration:
            return None
        return (self.count - 1) / duration


@dataclass(frozen=True, kw_only=True, eq=False)
class Request:
    """Columns to read of a table: samples, times and temperature, perhaps of some rows only."""

    table: Table
    samples: tuple[int, ...]
    times: tuple[TimeChoice, ...] = ()
    temperature: int | None = None
    rows: Rows = None

    @property
    def columns(self) -> tuple[int, ...]:
        """Indices of all columns, each once."""
        indices = [index for time in self.times for index in time.indices]
        heat = [] if self.temperature is None else [self.temperature]
        return tuple(dict.fromkeys([*indices, *self.samples, *heat]))


@dataclass(eq=False)
class Loaded:
    """Columns by index, shape (n,) each, which the caller may change; times are numbers.

    Texts of dates and times are in ns. Findings are about lost or damaged rows.
    """

    columns: dict[int, NDArray[Any]]
    findings: list[Finding] = field(default_factory=list)

    @property
    def n(self) -> int:
        return len(next(iter(self.columns.values())))


class Log(ABC):
    """An open log: its format, tables, and findings; close it after use."""

    #: As in `imucal.recording.Source`, such as ``csv``, ``mcap``, ``rosbag1``.
    form: str
    #: For example ``zstd``, ``none``, or empty.
    compression: str = ""
    #: Of all files; None for a stream.
    size_bytes: int | None = None
    #: A lower bound if only a part was read; None if unknown.
    unpacked_bytes: int | None = None
    #: Times of the first and last row of any table, in ns; None if unknown.
    start_ns: int | None = None
    end_ns: int | None = None
    #: What to do if its samples can't be found; often empty.
    advice: str = ""
    #: Time before the first row that was read, in s, if a part was read to save memory.
    left_out_s: float = 0.0

    def __init__(self, path: Path) -> None:
        self.path = path
        #: In messages and results.
        self.name = str(path)
        self.tables: list[Table] = []
        self.findings: list[Finding] = []

    @abstractmethod
    def read(self, requests: Sequence[Request]) -> list[Loaded]:
        """Return the columns of each request; all of them are read at once.

        Raises ReadError if the log can't be read; DataError if it has no rows.
        """

    def files(self) -> tuple[LogFileInfo, ...]:
        """Return size and checksum of a log that can't be read again; otherwise nothing."""
        return ()

    def close(self) -> None:  # noqa: B027 - not abstract: a log in memory has nothing to close
        """Close the files."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def table(self) -> Table | None:
        """The only table of a file that has no topics; None for other logs."""
        alone = len(self.tables) == 1 and not self.tables[0].is_topic
        return self.tables[0] if alone else None

"""The IMU messages of a ULog file, by pyulog: run in a child process, as pyulog may loop for ever."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucal.readers.ulog.ulog_messages import MESSAGES


class UlogMessages(NamedTuple):
    """The messages of one instance, by field, shape (n,) each."""

    name: str
    multi: int
    data: dict[str, NDArray[Any]]


class UlogContent(NamedTuple):
    """What a ULog file holds: IMU messages, whether parts are damaged, and dropouts of the logger in ms."""

    messages: list[UlogMessages]
    damaged: bool
    dropouts: list[int]


def ulog_content(path: Path) -> UlogContent:
    """Return the IMU messages of a ULog file."""
    from pyulog import ULog

    with path.open("rb") as file:
        log = ULog(file, message_name_filter_list=list(MESSAGES))
    return UlogContent(
        messages=[
            UlogMessages(
                name=entry.name,
                multi=int(entry.multi_id),
                # Copies: the fields of pyulog are views of all messages together.
                data={name: np.ascontiguousarray(values) for name, values in entry.data.items()},
            )
            for entry in log.data_list
            if entry.name in MESSAGES
        ],
        damaged=bool(log.file_corruption),
        dropouts=[int(dropout.duration) for dropout in log.dropouts],
    )

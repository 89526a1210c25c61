"""Sort messages by the time of recording."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.findings import Finding


def steps_back(times: IntArray) -> int:
    """Return the number of times earlier than the previous one."""
    return int(np.count_nonzero(np.diff(times) < 0))


def sort_by_log_time(stamps: IntArray, log: IntArray, columns: Iterable[NDArray[Any]]) -> list[Finding]:
    """Sort columns, shape (n,) each, in place if joined files or parallel writers disordered them.

    If that disorders the stamps, the recorder's clock was set back: nothing is sorted. `stamps` and `log` may
    be among the columns. Return a finding if the log times are disordered.
    """
    late = steps_back(log)
    if not late:
        return []
    order = np.argsort(log, kind="stable")
    if steps_back(stamps[order]) > steps_back(stamps):
        text = (
            f"The log time goes back {late} times and the time stamps do not; the order of the file is kept."
        )
        return [Finding("info", "log-out-of-order", text)]
    for column in columns:
        column[:] = column[order]
    text = f"{late} messages were out of order; they were sorted by log time."
    return [Finding("info", "log-out-of-order", text)]

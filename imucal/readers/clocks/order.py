"""The order of samples: that of the log, or of the time at which they were recorded."""

import numpy as np

from imucal.findings import Finding
from imucal.readers.containers.store import Columns, reorder


def in_time_order(columns: Columns) -> list[Finding]:
    """Sort samples by log time where the file does not hold them in that order, in place.

    Files are joined, channels merged and chunks written by several threads; a recorder's clock that was
    set back is none of these. So the sort is undone where it brings the stamps out of order.
    """
    late = int(np.count_nonzero(columns.log[1:] < columns.log[:-1]))
    if not late:
        return []
    order = np.argsort(columns.log, kind="stable")
    before = np.count_nonzero(columns.stamps[1:] < columns.stamps[:-1])
    sorted_stamps = columns.stamps[order]
    after = np.count_nonzero(sorted_stamps[1:] < sorted_stamps[:-1])
    if after > before:
        text = f"The log time goes back {late} times; the stamps do not, so the order of the file is kept."
        return [Finding(level="info", code="log-out-of-order", text=text)]
    reorder(columns, order)
    text = f"{late} messages stand in the file before earlier ones; they were put in order of log time."
    return [Finding(level="info", code="log-out-of-order", text=text)]

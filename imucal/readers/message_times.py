"""Times of decoded messages: in order, one of each element, and the clock that they give."""

import numpy as np

from imucal.arrays import BoolArray
from imucal.findings import Finding
from imucal.mapped import blocks
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import LOG_TIME, ClockReading, clock_from_stamps
from imucal.readers.column_store import Columns
from imucal.readers.messages import Choice, Topic
from imucal.readers.messages.fields_text import EACH
from imucal.readers.messages.list_messages import spread_times
from imucal.readers.out_of_order import steps_back, unsorted
from imucal.readers.read_options import ReadOptions
from imucal.readers.room import Room

#: Name of the time in the messages.
HEADER = "header stamp"


def spread_lists(topic: Topic, columns: Columns, room: Room) -> None:
    """Give the elements of lists that have no stamps of their own their times."""
    if topic.imu is None or not topic.imu.lists:
        return
    stamps, log = room.copied(columns.stamps), room.copied(columns.log)
    if topic.imu.stamp is None or EACH not in topic.imu.stamp.sec:
        spread_times(columns.stamps, (stamps, log))
    spread_times(columns.log, (log,))


def in_time_order(columns: Columns, room: Room) -> list[Finding]:
    """Sort samples by log time where the file does not hold them in that order, in place.

    Files are joined, channels merged and chunks written by several threads; a recorder's clock that was
    set back is none of these. So nothing is sorted where it brings the stamps out of order.
    """
    late = steps_back(columns.log)
    if not late:
        return []
    orders = [
        (first, np.argsort(columns.log[first:stop], kind="stable")) for first, stop in unsorted(columns.log)
    ]
    sorted_stamps = room.copied(columns.stamps)
    for first, order in orders:
        sorted_stamps[first : first + order.size] = columns.stamps[first + order]
    if steps_back(sorted_stamps) > steps_back(columns.stamps):
        text = f"The log time goes back {late} times; the stamps do not, so the order of the file is kept."
    else:
        for first, order in orders:
            columns.reorder(first, order)
        text = f"{late} messages stand in the file before earlier ones; they were put in order of log time."
    return [Finding(level="info", code="log-out-of-order", text=text)]


def clock_of(work: RecordingBuilder, choice: Choice, columns: Columns, options: ReadOptions) -> ClockReading:
    """Return the clock of a topic's samples: by their stamps, or by the log time where the user wants that.

    Raises
    ------
    DataError
        If no rate can be measured and none is given.
    """
    own = choice.topic.imu is not None and choice.topic.imu.stamp is not None
    by_log = options.time == "log"
    return clock_from_stamps(
        columns.log if by_log else columns.stamps,
        source=LOG_TIME if by_log else (HEADER if own else "stamp"),
        where=f"{work.path}: topic {choice.topic.name}",
        log_ns=columns.log,
        rate_hz=options.rate_hz,
        repeated=_repeated(columns, work.room),
        room=work.room,
    )


def _repeated(columns: Columns, room: Room) -> BoolArray | None:
    """Return the samples recorded twice: same stamp and same six values; None where there are none."""
    stamps = columns.stamps
    found = [
        np.flatnonzero(stamps[part.start + 1 : part.stop + 1] == stamps[part]) + part.start + 1
        for part in blocks(columns.n - 1, stamps)
    ]
    same = np.concatenate(found) if found else np.zeros(0, dtype=np.int64)
    if not same.size or len(columns.vectors) < 2:
        return None
    twin = stamps[same] != 0
    for rows in columns.vectors.values():
        for row in rows:
            twin &= row[same] == row[same - 1]
    if not twin.any():
        return None
    repeated = room.made(columns.n, np.bool_, lambda _: False)
    repeated[same[twin]] = True
    return repeated

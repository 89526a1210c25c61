"""Choose the tables to read: those named by the user, or the only ones with IMU samples."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

from imucal.errors import ChoiceError, Fix, joined
from imucal.readers.candidates import Candidate
from imucal.readers.files import refused
from imucal.readers.fixes import COLUMNS, TOPIC
from imucal.readers.read_options import ReadOptions
from imucal.readers.table import Log, Table
from imucal.readers.tables.columns import ColumnsError
from imucal.readers.tables.names import sensor_of_name
from imucal.readers.tables.plan import TablePlan
from imucal.recording import Sensor

#: Most topics listed in a message.
_MAX_TOPICS = 24
#: Most columns of a topic listed in a message.
_MAX_COLUMNS = 60

#: Files of apps without raw samples: estimates, other sensors, notes.
_LEFT_OUT = re.compile(
    r"linear|gravity|orientation|meta|annotation|magnet|baro|location|heart|pedo|step|light"
)
#: Preferred file names, best first.
_PREFERRED = {
    Sensor.GYROSCOPE: ("gyroscope", "raw data", "gyroscopeuncalibrated"),
    # Sensor Logger's Accelerometer.csv lacks gravity, TotalAcceleration.csv has it.
    Sensor.ACCELEROMETER: ("totalacceleration", "accelerometer", "accelerometeruncalibrated"),
}


@dataclass(frozen=True, eq=False)
class Choice:
    """A table to read, its columns, and the reason."""

    table: Table
    plan: TablePlan
    how: str


def candidates_of(log: Log, options: ReadOptions) -> list[Candidate]:
    """Return every table of a log as a candidate."""
    wanted: dict[str, Sensor] = {}
    if len(options.topics) == 2:
        # The first of two topics of vectors is the gyroscope.
        wanted = dict(zip(options.topics, Sensor, strict=True))
    return [
        Candidate(table, options, wanted=None if table.log_time is None else wanted.get(table.name))
        for table in log.tables
    ]


def choose(log: Log, options: ReadOptions) -> list[Choice]:
    """Choose the tables to read, and their columns.

    Raises ChoiceError if several fit, or none, or if the columns of one are ambiguous.
    """
    if not log.tables and log.advice:
        raise refused(log.name, log.advice, ChoiceError)
    candidates = candidates_of(log, options)
    if candidates and not candidates[0].table.is_topic:
        candidates = _of_files(candidates, options)
        if len(candidates) == 1 and not (options.topics and candidates[0].table.is_member):
            _refuse_topics(log, options)
            # The choice of columns reports missing sensors.
            return [_choice(candidates[0], tuple(Sensor), "the only table", log.advice)]
    if options.topics:
        return _named(log.name, candidates, options)
    return _of_topics(log, candidates, options)


def _of_topics(log: Log, candidates: Sequence[Candidate], options: ReadOptions) -> list[Choice]:
    """Choose the only topics with IMU samples."""
    carrying = [candidate for candidate in candidates if candidate.sensors and not candidate.is_empty]
    fitting = [candidate for candidate in carrying if not candidate.weak]
    if len(fitting) == 1:
        return [whole(fitting[0], "the only topic with IMU samples")]
    if fitting:
        return _among(log.name, fitting)
    if carrying:
        why = "no topic carries IMU messages, only vectors without a known meaning"
        raise refused(log.name, why, ChoiceError, _one_of(carrying))
    return [_unnamed(log.name, candidates, options)]


def _of_files(candidates: list[Candidate], options: ReadOptions) -> list[Candidate]:
    """Return the tables of files that may be read."""
    if not candidates[0].table.is_member:
        return [candidate for candidate in candidates if candidate.sensors] or [_widest(candidates)]
    return candidates if len(candidates) == 1 else _files_of_sensors(candidates, options)


def _widest(candidates: Sequence[Candidate]) -> Candidate:
    """Return the table of a file with most columns, whose error lists them."""
    return max(candidates, key=lambda candidate: (len(candidate.table.columns), candidate.table.count or 0))


def _refuse_topics(log: Log, options: ReadOptions) -> None:
    if options.topics:
        text = f"a table has no topics such as {', '.join(options.topics)}"
        raise refused(log.name, f"{text}; expected no topic, or a columns text", ChoiceError, COLUMNS)


def whole(candidate: Candidate, how: str) -> Choice:
    """Choose all sensors of a table."""
    of_names = candidate.sensors if candidate.table.is_topic else ()
    return _choice(candidate, of_names or tuple(Sensor), how)


def _choice(candidate: Candidate, sensors: Sequence[Sensor], how: str, advice: str = "") -> Choice:
    """Choose sensors of a table; `advice` helps if its columns are ambiguous."""
    try:
        plan = candidate.plan
    except ColumnsError as error:
        found = error.with_fixes(Fix(advice)) if advice else error
        raise joined(error.place, [found]) from error
    kept = tuple(sensor for sensor in plan.sensors if sensor.triad.sensor in sensors)
    return Choice(candidate.table, replace(plan, sensors=kept), how)


def _files_of_sensors(candidates: Sequence[Candidate], options: ReadOptions) -> list[Candidate]:
    """Return the files of an app, the unsuitable ones as weak, or without sensors."""
    left_out = [
        candidate
        for candidate in candidates
        if _LEFT_OUT.search(_stem(candidate)) and candidate.table.name not in options.topics
    ]
    found = [candidate for candidate in candidates if candidate not in left_out]
    for candidate in left_out:
        candidate.sensors = ()
    for candidate in found:
        if (named := sensor_of_name(_stem(candidate))) is not None:
            candidate.sensors = (named,)
    if any(sensor_of_name(_stem(candidate)) for candidate in candidates):
        # A file of several sensors repeats the samples of the others.
        for candidate in candidates:
            candidate.weak = sensor_of_name(_stem(candidate)) is None
    for sensor in Sensor:
        for candidate in _worse(candidates, sensor):
            candidate.weak = True
    return [*candidates]


def _worse(candidates: Sequence[Candidate], sensor: Sensor) -> list[Candidate]:
    """Return a sensor's files other than the one with the best name."""
    full = [candidate for candidate in candidates if sensor in candidate.sensors and not candidate.is_empty]
    for name in _PREFERRED[sensor]:
        exact = [candidate for candidate in full if _stem(candidate) == name]
        if len(exact) == 1:
            return [candidate for candidate in full if candidate is not exact[0]]
    return []


def _stem(candidate: Candidate) -> str:
    return PurePath(candidate.table.name).stem.lower()


def _unnamed(path: str, candidates: Sequence[Candidate], options: ReadOptions) -> Choice:
    """Return the only topic with numbers; raises ChoiceError without one, or without a columns text."""
    if options.columns is not None:
        raise _without_columns(path, candidates)
    there = [candidate for candidate in candidates if not candidate.is_empty]
    for candidate in there:
        if candidate.reason and (options.message_definitions or _looks_like_imu(candidate)):
            raise _unreadable(path, candidate)
    numbers = [candidate for candidate in there if candidate.table.columns]
    if len(numbers) == len(candidates) == 1:
        return _choice(numbers[0], tuple(Sensor), "the only topic")
    listed = listing(candidates) or "  no topics"
    way = "if one has samples of an IMU, name it and its columns in a columns text; imucal info -v lists them"
    fixes = [Fix(way, "columns", "TEXT")] if numbers else []
    why = "no topic carries a gyroscope or an accelerometer; found"
    raise refused(path, f"{why}\n{listed}", ChoiceError, *fixes)


def _without_columns(path: str, candidates: Sequence[Candidate]) -> ChoiceError:
    """Return the error for a columns text that fits no topic."""
    lines = []
    for candidate in candidates[:_MAX_TOPICS]:
        table = candidate.table
        lines.append(f"  {table.name} ({table.kind}): {candidate.reason}; found {columns_of(table)}")
    listed = "\n".join(lines) or "  no topics"
    why = "no topic has the columns in the columns text; found these topics"
    return refused(path, f"{why}\n{listed}", ChoiceError, COLUMNS)


def columns_of(table: Table) -> str:
    """Return the columns of a topic for a message."""
    names = [column.name for column in table.columns]
    more = f", … {len(names) - _MAX_COLUMNS} more" if len(names) > _MAX_COLUMNS else ""
    return ", ".join(names[:_MAX_COLUMNS]) + more or "none with numbers"


def listing(candidates: Sequence[Candidate]) -> str:
    """Return topics as lines of name, type, messages, rate and duration."""
    rows = []
    for table in (candidate.table for candidate in candidates[:_MAX_TOPICS]):
        count = "? messages" if table.count is None else f"{table.count} messages"
        rate = "" if table.measured_hz is None else f"{table.measured_hz:.4g} Hz"
        duration = "" if table.duration_s is None else f"{table.duration_s:.4g} s"
        rows.append((table.name, table.kind, count, rate, duration))
    a, b, c, d, _ = (max(map(len, column)) for column in zip(*rows, strict=True)) if rows else [0] * 5
    lines = [
        f"  {n:{a}}  {t:{b}}  {count:>{c}}  {rate:>{d}}  {last}".rstrip() for n, t, count, rate, last in rows
    ]
    if len(candidates) > _MAX_TOPICS:
        lines.append(f"  and {len(candidates) - _MAX_TOPICS} more")
    return "\n".join(lines)


def _looks_like_imu(candidate: Candidate) -> bool:
    name = candidate.table.kind.lower().rpartition("/")[2]
    return "imu" in name or name.endswith("sensorcombined")


def _unreadable(path: str, candidate: Candidate) -> ChoiceError:
    table = candidate.table
    why = candidate.reason or "its messages contain no numbers"
    found = f"; found {columns_of(table)}" if table.columns else ""
    what = table.name if table.is_member else f"topic {table.name} of type {table.kind or 'unknown'}"
    text = f"{what} can't be read: {why}{found}"
    return refused(path, text, ChoiceError, *candidate.fixes)


def _named(path: str, candidates: Sequence[Candidate], options: ReadOptions) -> list[Choice]:
    if len(options.topics) > 2:
        named = f"{len(options.topics)} topics are named; expected one, or one for each sensor"
        raise refused(path, named, ChoiceError, TOPIC)
    found = [_find(path, candidates, name) for name in options.topics]
    for candidate in found:
        if candidate.reason or not candidate.table.columns:
            raise _unreadable(path, candidate)
        if candidate.is_empty:
            empty = f"topic {candidate.table.name} has no messages; found\n{listing(candidates)}"
            raise refused(path, empty, ChoiceError, TOPIC)
    if len(found) == 1:
        return [whole(found[0], "as given")]
    for gyro, accel in (found, found[::-1]):
        if Sensor.GYROSCOPE in gyro.alive and Sensor.ACCELEROMETER in accel.alive:
            return _pair(gyro, accel, "as given")
    what = "; ".join(
        f"{candidate.table.name}: {' and '.join(sorted(candidate.alive)) or 'no samples that change'}"
        for candidate in found
    )
    text = f"the two topics are not a gyroscope and an accelerometer ({what})"
    raise refused(path, text, ChoiceError, TOPIC)


def _find(path: str, candidates: Sequence[Candidate], name: str) -> Candidate:
    wanted = name.strip("/")
    same = [
        candidate
        for candidate in candidates
        if wanted in {candidate.table.name.strip("/"), candidate.table.alias}
    ]
    if not same:
        raise refused(path, f"there is no topic {name}", ChoiceError, _one_of(candidates))
    return next((candidate for candidate in same if candidate.sensors), same[0])


def _among(path: str, fitting: Sequence[Candidate]) -> list[Choice]:
    useful = [candidate for candidate in fitting if candidate.alive]
    if len(useful) == 1:
        return [whole(useful[0], "the only topic whose samples change")]
    gyros = [candidate for candidate in useful if Sensor.GYROSCOPE in candidate.alive]
    accels = [candidate for candidate in useful if Sensor.ACCELEROMETER in candidate.alive]
    if len(gyros) == len(accels) == 1 and gyros[0] is not accels[0]:
        return _pair(gyros[0], accels[0], "the only topic of this sensor")
    raise refused(path, f"{len(fitting)} topics carry IMU samples", ChoiceError, _one_of(fitting))


def _one_of(candidates: Sequence[Candidate]) -> Fix:
    listed = listing(candidates) or "  no topics"
    return Fix(f"choose one of these topics\n{listed}", "topic", "NAME")


def _pair(gyro: Candidate, accel: Candidate, how: str) -> list[Choice]:
    return [
        _choice(gyro, [Sensor.GYROSCOPE], f"gyroscope, {how}"),
        _choice(accel, [Sensor.ACCELEROMETER], f"accelerometer, {how}"),
    ]

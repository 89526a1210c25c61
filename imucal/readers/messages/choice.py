"""Choose the topics to read: those named by the user, or the only ones with IMU samples."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from imucal.errors import ChoiceError, Fix
from imucal.readers.files import refused
from imucal.readers.fixes import COLUMNS, TOPIC
from imucal.readers.messages.topics import Topic
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor

_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
#: Most topics listed in a message.
_MAX_TOPICS = 24
#: Most columns of a topic listed in a message.
_MAX_COLUMNS = 60


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """A topic to read, its sensors, and the reason."""

    topic: Topic
    sensors: tuple[Sensor, ...]
    how: str


def choose(
    path: Path,
    topics: Sequence[Topic],
    options: ReadOptions,
    live: Callable[[Topic], frozenset[Sensor]],
) -> list[Choice]:
    """Choose topics; `live` returns the sensors of a topic whose samples change.

    Raises ChoiceError if several fit, or none.
    """
    if options.topics:
        return _named(path, topics, options, live)
    if len(topics) == 1 and topics[0].file:
        # The choice of columns reports missing sensors.
        return [Choice(topics[0], tuple(Sensor), "the only table")]
    carrying = [topic for topic in topics if topic.sensors and topic.count != 0]
    fitting = [topic for topic in carrying if not topic.plain]
    if len(fitting) == 1:
        return [Choice(fitting[0], fitting[0].sensors, "the only topic with IMU samples")]
    if fitting:
        return _among(path, fitting, live)
    if carrying:
        why = "no topic carries IMU messages, only vectors without a known meaning"
        raise refused(path, why, ChoiceError, _one_of(carrying))
    return [_unnamed(path, topics, options)]


def _unnamed(path: Path, topics: Sequence[Topic], options: ReadOptions) -> Choice:
    """Return the only topic with numbers; raises ChoiceError without one, or without a columns text."""
    if options.columns is not None:
        lines = [f"  {topic.name} ({topic.type}): {topic.reason}; found {columns(topic)}" for topic in topics]
        listed = "\n".join(lines[:_MAX_TOPICS]) or "  no topics"
        why = "no topic has the columns in the columns text; found these topics"
        raise refused(path, f"{why}\n{listed}", ChoiceError, COLUMNS)
    unreadable = [topic for topic in topics if topic.reason and topic.count != 0 and _looks_like_imu(topic)]
    if unreadable:
        raise _unreadable(path, unreadable[0])
    numbers = [topic for topic in topics if topic.columns and topic.count != 0]
    if len(numbers) == len(topics) == 1:
        return Choice(numbers[0], tuple(Sensor), "the only topic")
    listed = table(topics) or "  no topics"
    way = "if one has samples of an IMU, name it and its columns in a columns text; imucal info -v lists them"
    fixes = [Fix(way, "columns", "TEXT")] if numbers else []
    why = "no topic carries a gyroscope or an accelerometer; found"
    raise refused(path, f"{why}\n{listed}", ChoiceError, *fixes)


def columns(topic: Topic) -> str:
    """Return the columns of a topic for a message."""
    names = [column.name for column in topic.columns]
    more = f", … {len(names) - _MAX_COLUMNS} more" if len(names) > _MAX_COLUMNS else ""
    return ", ".join(names[:_MAX_COLUMNS]) + more or "none with numbers"


def table(topics: Sequence[Topic]) -> str:
    """Return the topics as lines of name, type, messages, rate and duration."""
    rows = []
    for topic in topics[:_MAX_TOPICS]:
        count = "? messages" if topic.count is None else f"{topic.count} messages"
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.4g} Hz"
        duration = "" if topic.duration_s is None else f"{topic.duration_s:.4g} s"
        rows.append((topic.name, topic.type, count, rate, duration))
    a, b, c, d, _ = (max(map(len, column)) for column in zip(*rows, strict=True)) if rows else [0] * 5
    lines = [
        f"  {n:{a}}  {t:{b}}  {count:>{c}}  {rate:>{d}}  {last}".rstrip() for n, t, count, rate, last in rows
    ]
    if len(topics) > _MAX_TOPICS:
        lines.append(f"  and {len(topics) - _MAX_TOPICS} more")
    return "\n".join(lines)


def _looks_like_imu(topic: Topic) -> bool:
    name = topic.type.lower().rpartition("/")[2]
    return "imu" in name or name.endswith("sensorcombined") or bool(topic.given)


def _unreadable(path: Path, topic: Topic) -> ChoiceError:
    kind, why = topic.type or "unknown", topic.reason or "its messages contain no numbers"
    found = f"; found {columns(topic)}" if topic.columns else ""
    return refused(
        path, f"topic {topic.name} of type {kind} can't be read: {why}{found}", ChoiceError, *topic.fixes
    )


def _named(
    path: Path, topics: Sequence[Topic], options: ReadOptions, live: Callable[[Topic], frozenset[Sensor]]
) -> list[Choice]:
    if len(options.topics) > 2:
        named = f"{len(options.topics)} topics are named; expected one, or one for each sensor"
        raise refused(path, named, ChoiceError, TOPIC)
    found = [_find(path, topics, name) for name in options.topics]
    for topic in found:
        if topic.reason or not topic.columns:
            raise _unreadable(path, topic)
        if topic.count == 0:
            empty = f"topic {topic.name} has no messages; found\n{table(topics)}"
            raise refused(path, empty, ChoiceError, TOPIC)
    if len(found) == 1:
        return [Choice(found[0], found[0].sensors or tuple(Sensor), "as given")]
    alive = [live(topic) for topic in found]
    for gyro, accel in ((0, 1), (1, 0)):
        if _GYRO in alive[gyro] and _ACCEL in alive[accel]:
            return _pair(found[gyro], found[accel], "as given")
    what = "; ".join(
        f"{topic.name}: {' and '.join(sorted(sensors)) or 'no samples that change'}"
        for topic, sensors in zip(found, alive, strict=True)
    )
    text = f"the two topics are not a gyroscope and an accelerometer ({what})"
    raise refused(path, text, ChoiceError, TOPIC)


def _find(path: Path, topics: Sequence[Topic], name: str) -> Topic:
    same = [topic for topic in topics if topic.name.strip("/") == name.strip("/")]
    if not same:
        raise refused(path, f"there is no topic {name}", ChoiceError, _one_of(topics))
    return next((topic for topic in same if topic.sensors), same[0])


def _among(path: Path, fitting: Sequence[Topic], live: Callable[[Topic], frozenset[Sensor]]) -> list[Choice]:
    alive = {topic.name: live(topic) for topic in fitting}
    useful = [topic for topic in fitting if alive[topic.name]]
    if len(useful) == 1:
        return [Choice(useful[0], useful[0].sensors, "the only topic whose samples change")]
    gyros = [topic for topic in useful if _GYRO in alive[topic.name]]
    accels = [topic for topic in useful if _ACCEL in alive[topic.name]]
    if len(gyros) == len(accels) == 1 and gyros[0] is not accels[0]:
        return _pair(gyros[0], accels[0], "the only topic of this sensor")
    raise refused(path, f"{len(fitting)} topics carry IMU samples", ChoiceError, _one_of(fitting))


def _one_of(topics: Sequence[Topic]) -> Fix:
    listed = table(topics) or "  no topics"
    return Fix(f"choose one of these topics\n{listed}", "topic", "NAME")


def _pair(gyro: Topic, accel: Topic, how: str) -> list[Choice]:
    return [
        Choice(gyro, (_GYRO,), f"gyroscope, {how}"),
        Choice(accel, (_ACCEL,), f"accelerometer, {how}"),
    ]

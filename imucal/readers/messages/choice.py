"""Which topics to read: what the caller says, or the only ones that fit; never a silent pick."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from imucal.errors import ChoiceError
from imucal.readers.messages.topics import Topic
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor

_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
#: Topics listed in a message.
_MOST = 24


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """A topic to read, the sensors to take from it, and how it was chosen."""

    topic: Topic
    sensors: tuple[Sensor, ...]
    how: str


def choose(
    path: Path,
    topics: Sequence[Topic],
    options: ReadOptions,
    live: Callable[[Topic], frozenset[Sensor]],
) -> list[Choice]:
    """Choose topics.

    Parameters
    ----------
    live
        Says which sensors of a topic have data that change.

    Raises
    ------
    ChoiceError
        If several topics could be meant, or none fits; the message lists them.
    """
    if options.topics:
        return _named(path, topics, options, live)
    carrying = [topic for topic in topics if topic.imu is not None and topic.count != 0]
    if options.fields and not carrying:
        raise _no_fields(path, topics)
    fitting = [topic for topic in carrying if topic.imu is not None and not topic.imu.plain]
    if len(fitting) == 1:
        return [_whole(fitting[0], "the only topic with IMU samples")]
    if fitting:
        return _among(path, fitting, live)
    return _refuse(path, topics, carrying)


def _no_fields(path: Path, topics: Sequence[Topic]) -> ChoiceError:
    """Return the error where no topic has the fields that the user named; it lists what there is."""
    lines = [
        f"  {topic.name} ({topic.type}): {topic.reason}; found {topic.leaves.shown()}"
        for topic in topics
        if topic.leaves.all or topic.reason
    ]
    listed = "\n".join(lines[:_MOST]) or "  nothing that can be read"
    return ChoiceError(f"{path}: no topic has the fields of the fields text; found in its topics\n{listed}")


def table(topics: Sequence[Topic]) -> str:
    """Return the topics as lines of name, type, messages, rate and duration."""
    rows = [_row(topic) for topic in topics[:_MOST]]
    widths = [max(len(row[i]) for row in rows) for i in range(4)] if rows else []
    lines = [
        "  " + "  ".join([row[0].ljust(widths[0]), row[1].ljust(widths[1]), row[2].rjust(widths[2]),
                          row[3].rjust(widths[3]), row[4]]).rstrip()
        for row in rows
    ]  # fmt: skip
    if len(topics) > _MOST:
        lines.append(f"  and {len(topics) - _MOST} more")
    return "\n".join(lines)


def _row(topic: Topic) -> tuple[str, str, str, str, str]:
    count = "? messages" if topic.count is None else f"{topic.count} messages"
    rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.4g} Hz"
    duration = "" if topic.duration_s is None else f"{topic.duration_s:.4g} s"
    return topic.name, topic.type, count, rate, duration


def _whole(topic: Topic, how: str) -> Choice:
    sensors = topic.imu.sensors if topic.imu is not None else ()
    return Choice(topic=topic, sensors=sensors, how=how)


def _named(
    path: Path, topics: Sequence[Topic], options: ReadOptions, live: Callable[[Topic], frozenset[Sensor]]
) -> list[Choice]:
    """Take the topics the caller names: one, or one for each sensor."""
    if len(options.topics) > 2:
        msg = f"{path}: {len(options.topics)} topics are named; expected one, or one for each sensor"
        raise ChoiceError(msg)
    found = [_find(path, topics, name) for name in options.topics]
    for topic in found:
        if topic.imu is None:
            why = topic.reason or "its messages have no angular velocity or linear acceleration"
            why += f"; found {topic.leaves.shown()}" if options.fields else ""
            msg = f"{path}: topic {topic.name} of type {topic.type or 'unknown'} can't be read: {why}"
            raise ChoiceError(msg)
        if topic.count == 0:
            msg = f"{path}: topic {topic.name} has no messages; found\n{table(topics)}"
            raise ChoiceError(msg)
    if len(found) == 1:
        return [_whole(found[0], "as asked for")]
    first, second = found
    a, b = live(first), live(second)
    if _GYRO in a and _ACCEL in b:
        pair = (first, second)
    elif _GYRO in b and _ACCEL in a:
        pair = (second, first)
    else:
        what = "; ".join(f"{topic.name}: {_words(live(topic))}" for topic in found)
        msg = f"{path}: the two topics are not a gyroscope and an accelerometer ({what})"
        raise ChoiceError(msg)
    return _pair(*pair, "as asked for")


def _find(path: Path, topics: Sequence[Topic], name: str) -> Topic:
    same = [topic for topic in topics if topic.name.strip("/") == name.strip("/")]
    if not same:
        listed = table(topics) or "  no topics"
        msg = f"{path}: there is no topic {name}; choose one of these topics\n{listed}"
        raise ChoiceError(msg)
    return next((topic for topic in same if topic.imu is not None), same[0])


def _among(path: Path, fitting: Sequence[Topic], live: Callable[[Topic], frozenset[Sensor]]) -> list[Choice]:
    """Choose where several topics fit only if their data leave one way."""
    alive = {topic.name: live(topic) for topic in fitting}
    useful = [topic for topic in fitting if alive[topic.name]]
    if len(useful) == 1:
        return [_whole(useful[0], "the only topic whose samples change")]
    gyros = [topic for topic in useful if _GYRO in alive[topic.name]]
    accels = [topic for topic in useful if _ACCEL in alive[topic.name]]
    if len(gyros) == len(accels) == 1 and gyros[0] is not accels[0]:
        return _pair(gyros[0], accels[0], "the only topic with its samples")
    msg = f"{path}: {len(fitting)} topics carry IMU samples; choose one of these topics\n{table(fitting)}"
    raise ChoiceError(msg)


def _pair(gyro: Topic, accel: Topic, how: str) -> list[Choice]:
    return [
        Choice(topic=gyro, sensors=(_GYRO,), how=f"gyroscope, {how}"),
        Choice(topic=accel, sensors=(_ACCEL,), how=f"accelerometer, {how}"),
    ]


def _words(sensors: frozenset[Sensor]) -> str:
    return " and ".join(sorted(sensors)) or "no samples that change"


def _refuse(path: Path, topics: Sequence[Topic], carrying: Sequence[Topic]) -> NoReturn:
    if carrying:
        msg = (
            f"{path}: no topic carries IMU messages, only vectors that may be anything; "
            f"choose one of these topics\n{table(carrying)}"
        )
        raise ChoiceError(msg)
    unreadable = [topic for topic in topics if topic.reason and topic.count != 0]
    if unreadable:
        topic = unreadable[0]
        msg = f"{path}: topic {topic.name} of type {topic.type or 'unknown'} can't be read: {topic.reason}"
        raise ChoiceError(msg)
    listed = table(topics) or "  no topics"
    able = [topic for topic in topics if topic.count != 0 and topic.leaves.proposal()]
    how = "".join(
        f"\n{topic.name} may be read by a fields text such as {topic.leaves.proposal()!r}"
        for topic in able[:3]
    )
    msg = f"{path}: no topic carries a gyroscope or an accelerometer; found\n{listed}{how}"
    raise ChoiceError(msg)

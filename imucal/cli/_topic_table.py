"""A table of a log's topics, for terminals wide and narrow."""

from collections.abc import Iterator
from dataclasses import replace

from imucal.cli._terminal import FULL, width, wrapped
from imucal.cli._topic_reading import TopicReading
from imucal.printable import printable
from imucal.readers import TopicContents
from imucal.units import duration


def without_repeated_note(topic: TopicContents, found: TopicReading | None) -> TopicContents:
    """Return a topic without a note that only repeats how its samples were read."""
    decisions = () if found is None or found.recording is None else found.recording.source.decisions
    repeated = topic.note == "; ".join(
        f"{question} {answer}" for question, answer in decisions if "unit" in question
    )
    return replace(topic, note="") if repeated else topic


def topic_table(topics: list[TopicContents]) -> Iterator[str]:
    """Yield a line a topic, and a second one for a note or for a name that does not fit."""
    rows = [(_one_line(topic.name), _one_line(topic.type), *_figures(topic)) for topic in topics]
    heads = ("topic", "type", "messages", "rate", "duration", "sensors")
    if width() < FULL:
        for topic in topics:
            yield from _topic_lines(topic)
        return
    widths = [max(len(heads[i]), *(len(row[i]) for row in rows)) for i in range(6)]
    spare = width() - 2 - 2 * 5 - sum(widths[2:])
    widths[1] = min(widths[1], max(spare - min(widths[0], spare // 2), 8))
    widths[0] = min(widths[0], max(spare - widths[1], 8))
    yield _row(heads, widths)
    for topic, row in zip(topics, rows, strict=True):
        long = [text for text, width in zip(row[:2], widths[:2], strict=True) if len(text) > width]
        fitted = [_fit(text, width) for text, width in zip(row[:2], widths[:2], strict=True)]
        yield _row((*fitted, *row[2:]), widths)
        for text in [*long, *([topic.note] if topic.note else [])]:
            yield from wrapped(text, indent=6)


def _one_line(text: str) -> str:
    return printable(text).replace("\n", "\\n")


def _topic_lines(topic: TopicContents) -> Iterator[str]:
    """Yield a topic's lines for a narrow terminal."""
    count, rate, length, sensors = _figures(topic)
    figures = ", ".join(filter(None, (f"{count} messages", rate, length, sensors)))
    for text, indent in ((topic.name, 2), (topic.type, 4), (figures, 4), (topic.note, 6)):
        if text:
            yield from wrapped(_one_line(text), indent=indent)


def _row(cells: tuple[str, ...], widths: list[int]) -> str:
    name, kind, *figures, sensors = cells
    middle = [text.rjust(width) for text, width in zip(figures, widths[2:5], strict=True)]
    left = [name.ljust(widths[0]), kind.ljust(widths[1])]
    return ("  " + "  ".join([*left, *middle, sensors])).rstrip()


def _figures(topic: TopicContents) -> tuple[str, str, str, str]:
    count = "?" if topic.count is None else str(topic.count)
    rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.4g} Hz"
    length = "" if topic.duration_s is None else duration(topic.duration_s)
    return count, rate, length, ", ".join(sensor.short for sensor in topic.sensors)


def _fit(text: str, width: int) -> str:
    """Return a text that is cut in its middle where it is too long."""
    if len(text) <= width:
        return text
    left = (width - 1) // 2
    return text[:left] + "…" + text[len(text) - (width - 1 - left) :]

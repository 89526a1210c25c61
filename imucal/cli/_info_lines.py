"""What is in a log, in lines for people."""

from collections.abc import Iterator, Sequence
from typing import TypeAlias

from imucal.cli import options_for
from imucal.cli._finding_lines import suggestion
from imucal.cli._terminal import wrapped
from imucal.cli._topic_reading import TopicReading
from imucal.cli._topic_table import topic_table, without_repeated_note
from imucal.findings import Finding
from imucal.readers import LogContents, TopicContents
from imucal.readers.tables.text_source import STANDARD_INPUT
from imucal.remote import is_url
from imucal.units import data_size, duration

#: Level, code and sentence of a finding: what it says, whatever axis it is about.
_Words: TypeAlias = tuple[str, str, str]
#: Stamps before this, 1 January 1980 in ns, count from the start of a computer or a sensor: no date.
_NO_DATE = 315_532_800_000_000_000


def lines_of_log(
    contents: LogContents, found: dict[str, TopicReading], *, looked: bool, verbose: bool
) -> Iterator[str]:
    """Yield the lines of a log: its table of topics, and of those that were read what was found."""
    yield from wrapped(contents.path)
    yield from wrapped(", ".join(_head(contents)), indent=2)
    topics = [*contents.imu_topics, *(topic for topic in contents.topics if not topic.sensors)]
    if topics:
        yield ""
        yield from topic_table([without_repeated_note(topic, found.get(topic.name)) for topic in topics])
    if verbose:
        yield from _fields(topics)
    said = {_words(finding) for finding in contents.findings}
    for topic in contents.imu_topics:
        yield from _what_was_read(topic, found.get(topic.name), said)
    if contents.imu_topics and not looked:
        yield ""
        where = "in a large log; --gaps reads all samples"
        if contents.path == STANDARD_INPUT:
            where = "on standard input"
        elif is_url(contents.path):
            where = "behind a URL; --gaps downloads the log"
        yield from wrapped(f"Gaps are not looked for {where}.")
    if not contents.imu_topics:
        yield ""
        yield from _nothing(contents)
    for finding in contents.findings:
        yield from _sentence(_words(finding), [])
    yield ""


def _fields(topics: Sequence[TopicContents]) -> Iterator[str]:
    """Yield the fields of each topic's messages, to choose from."""
    for topic in topics:
        if topic.fields:
            yield ""
            yield from wrapped(f"{topic.name} has the fields")
            yield from wrapped(", ".join(topic.fields), indent=2)


def _nothing(contents: LogContents) -> Iterator[str]:
    """Say that no samples can be read, and with which options of other commands they could be."""
    hints = [hint for topic in contents.topics if (hint := options_for(topic.note))]
    if not hints:
        yield "No gyroscope or accelerometer was found."
        return
    yield from wrapped(f"As it is, no samples can be read; give imucal fit {hints[0]}.")


def _head(contents: LogContents) -> Iterator[str]:
    yield contents.format
    if contents.compression:
        yield f"compression {contents.compression}"
    if contents.size_bytes is not None:
        yield data_size(contents.size_bytes)
    if contents.duration_s is not None:
        yield duration(contents.duration_s)
    if contents.start_ns is not None and contents.start_ns > _NO_DATE:
        yield f"from {_date(contents.start_ns)}"


def _what_was_read(topic: TopicContents, found: TopicReading | None, said: set[_Words]) -> Iterator[str]:
    """Yield rate, gaps, units and findings of a topic that was read; not those said of the whole log."""
    if found is None:
        return
    yield ""
    if found.recording is None:
        yield from wrapped(f"{topic.name}: {found.error}")
        return
    clocks = {id(series.clock): series for series in found.recording.series}
    for series in clocks.values():
        clock = series.clock
        jitter = "" if clock.jitter_s is None else f", {_jitter(clock.jitter_s)}"
        count = f"{len(clock.gaps)} gap{'s' if len(clock.gaps) > 1 else ''}"
        gaps = f"{count}, {clock.missing} missing" if clock.gaps else "no gaps"
        text = f"{topic.name}: {clock.rate_hz:.6g} Hz by {clock.source}, {clock.n} samples, {gaps}{jitter}"
        yield from wrapped(text)
    for question, answer in found.recording.source.decisions:
        # Each topic is read by its name here, which says nothing about what fit would choose.
        if question not in {"topic", "topics"}:
            yield from wrapped(f"{question}: {answer}", indent=2)
    about: dict[_Words, list[str]] = {}
    for finding in found.recording.findings:
        about.setdefault(_words(finding), []).extend([finding.axis] if finding.axis else [])
    for words, axes in about.items():
        if words not in said:
            yield from _sentence(words, axes)


def _jitter(seconds: float) -> str:
    """Return ``jitter 72 ns``; a stamp is a whole number of ns, so that less is none."""
    if seconds < 1e-9:
        return "no jitter"
    unit, size = next(
        pair for pair in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)) if seconds >= pair[1]
    )
    return f"jitter {seconds / size:.3g} {unit}"


def _words(finding: Finding) -> _Words:
    parts = (finding.text, finding.advice, suggestion(finding))
    return finding.level, finding.code, " ".join(part for part in parts if part)


def _sentence(words: _Words, axes: list[str]) -> Iterator[str]:
    level, code, text = words
    where = f" {' '.join(dict.fromkeys(axes))}" if axes else ""
    yield from wrapped(f"{level} [{code}]{where}: {text}", indent=2)


def _date(ns: int) -> str:
    from datetime import UTC, datetime

    try:
        return datetime.fromtimestamp(ns / 1e9, tz=UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (ValueError, OverflowError, OSError):
        return f"{ns / 1e9:.6g} s"

"""``imucal info``: the contents of a log, from its index; gaps and clocks if the log is small."""

from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from imucal.cli._fixes import options_for
from imucal.cli._printing import (
    FULL,
    FindingText,
    echo,
    finding_text,
    picked,
    print_json,
    sentence_of,
    width,
    wrapped,
)
from imucal.cli.context import is_set
from imucal.cli.log_request import lent
from imucal.cli.options import (
    OUTPUT,
    Command,
    context_flag,
    flag,
    logs_argument,
    option,
    reading_options,
    unwrapped,
)
from imucal.errors import ImucalError
from imucal.findings import Finding
from imucal.printable import printable
from imucal.readers import LogContents, TopicContents, describe, logs_of, read
from imucal.readers.read_options import options_of
from imucal.readers.tables.text_source import STANDARD_INPUT
from imucal.recording import Recording
from imucal.remote.addresses import shown
from imucal.screening import screen_units, worst_first
from imucal.units import TIME_UNITS_NS, data_size, duration

if TYPE_CHECKING:
    from imucal.readers.remote_logs import LocalLogs

SCHEMA = "imucal/info/1"
_FINDING = "level code axis text advice"
#: None if the topic was not read; a text is the message of the error.
Reading: TypeAlias = Recording | str | None
_JOINED_WHERE = "imucal fit joins them if each continues the one before, or with --join."
#: Logs up to this size, in bytes, are always read in full, which takes less than a second.
_SMALL = 1 << 26
#: Largest number of samples of a log that is always read: compression may hide very many.
_MANY = 4_000_000


_EPILOG = unwrapped("""
Examples:
  imucal info log.mcap
  imucal info --gaps 20h.bag
  imucal info 's3://bucket/run/*.mcap'
  imucal info -v --msg MyImu.msg old.db3
  imucal info --json *.mcap | jq '.logs[].topics[].rate_hz'

Exit codes: 0 done, 2 usage, 3 a log can't be read.
""")


@click.command(cls=Command, epilog=_EPILOG)
@logs_argument("LOG...", required=True)
@option(
    "--gaps/--no-gaps",
    default=None,
    help="Also read the samples, to find gaps and clock errors (default: logs up to 64 MB).",
)
@flag("--json", "as_json", group=OUTPUT, help="Print JSON on standard output.")
@context_flag("-v", "--verbose", group=OUTPUT, help="Also list the fields of messages.")
@reading_options
def command(*, logs: tuple[str, ...], as_json: bool, gaps: bool | None, reading: dict[str, Any]) -> None:
    """List the topics, types, counts, rates, duration, units and gaps of each LOG."""
    entries = []
    folders = {named: parts for named in logs if len(parts := logs_of(named)) > 1}
    for log in (log for named in logs for log in folders.get(named, [named])):
        with lent([log]) as local:
            contents = local.with_urls(describe(local.paths[0], options_of(**reading)))
            small = contents.size_bytes is not None and _is_small(contents)
            # Standard input can't be read a second time.
            wanted = (small if gaps is None else gaps) and log != STANDARD_INPUT
            found = _read_topics(local, contents, reading) if wanted else {}
        if as_json:
            entries.append(_log_document(contents, found))
        else:
            echo("\n".join(_lines_of_log(contents, found, looked=wanted)))
    for folder, parts in folders.items() if not as_json else ():
        text = f"{shown(folder)}: {len(parts)} logs without a metadata.yaml that joins them."
        echo("\n".join([*wrapped(f"{text} {_JOINED_WHERE}"), ""]))
    if as_json:
        print_json({"schema": SCHEMA, "logs": entries}, ascii_only=False)


def _is_small(contents: LogContents) -> bool:
    samples = sum(topic.count or 0 for topic in contents.imu_topics)
    size = max(contents.size_bytes or 0, contents.unpacked_bytes or 0)
    return size <= _SMALL and samples <= _MANY


def _read_topics(local: "LocalLogs", contents: LogContents, reading: dict[str, Any]) -> dict[str, Reading]:
    """Read every topic with IMU samples; a table is read as a whole."""
    found: dict[str, Reading] = {}
    for topic in contents.imu_topics:
        named = topic.name if len(contents.topics) > 1 else None
        try:
            found[topic.name] = local.named(read(*local.paths, topic=named, **reading))
        except ImucalError as error:
            found[topic.name] = str(local.with_urls(error))
    return found


def _log_document(contents: LogContents, found: dict[str, Reading]) -> dict[str, object]:
    """Return the entry of a log, with the clocks and findings of the topics that were read."""
    return {
        **picked(contents, "path format compression unpacked_bytes size_bytes start_ns duration_s"),
        "topics": [_topic_json(topic, found.get(topic.name)) for topic in contents.topics],
        "findings": [picked(finding, _FINDING) for finding in contents.findings],
    }


def _topic_json(topic: TopicContents, found: Reading) -> dict[str, object]:
    entry: dict[str, object] = {**asdict(topic), "sensors": list(map(str, topic.sensors))}
    if isinstance(found, str):
        entry["error"] = found
    elif found is not None:
        clocks = {str(series.sensor): series.clock for series in found.series}
        entry["clocks"] = {
            sensor: {
                **picked(clock, "source rate_hz samples=n jitter_s missing"),
                "gaps": [asdict(gap) for gap in clock.gaps],
            }
            for sensor, clock in clocks.items()
        }
        entry["decisions"] = found.source.decisions
        entry["findings"] = [picked(finding, _FINDING) for finding in _findings(found)]
    return entry


def _findings(found: Recording) -> tuple[Finding, ...]:
    """Return the findings of reading a log, and those of `fit` about the accelerometer's unit."""
    return (*found.findings, *worst_first(found, screen_units(found)))


def _without_repeated_note(topic: TopicContents, found: Reading) -> TopicContents:
    """Return a topic, without its note if that only repeats the decisions about units."""
    decisions = found.source.decisions if isinstance(found, Recording) else ()
    repeated = bool(topic.decisions) and set(topic.decisions) <= set(decisions)
    return replace(topic, note="") if repeated else topic


def _topic_table(topics: list[TopicContents]) -> Iterator[str]:
    """Yield one line per topic, and further lines for a note or a name that does not fit."""
    if width() < FULL:
        for topic in topics:
            yield from _topic_lines(topic)
        return
    rows = [(_one_line(topic.name), _one_line(topic.type), *_figures(topic)) for topic in topics]
    heads = ("topic", "type", "messages", "rate", "duration", "sensors")
    widths = [max(len(heads[i]), *(len(row[i]) for row in rows)) for i in range(6)]
    spare = width() - 2 - 2 * 5 - sum(widths[2:])
    widths[1] = min(widths[1], max(spare - min(widths[0], spare // 2), 8))
    widths[0] = min(widths[0], max(spare - widths[1], 8))
    line = "  ".join(["", *(f"{{:{side}{most}}}" for side, most in zip("<<>>>", widths, strict=False)), "{}"])
    yield line.format(*heads)
    for topic, row in zip(topics, rows, strict=True):
        names = list(zip(row[:2], widths[:2], strict=True))
        yield line.format(*(_fit(text, most) for text, most in names), *row[2:]).rstrip()
        for text in (*(text for text, most in names if len(text) > most), topic.note):
            if text:
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


def _figures(topic: TopicContents) -> tuple[str, str, str, str]:
    count = "?" if topic.count is None else str(topic.count)
    rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.4g} Hz"
    length = "" if topic.duration_s is None else duration(topic.duration_s)
    return count, rate, length, ", ".join(sensor.short for sensor in topic.sensors)


def _fit(text: str, most: int) -> str:
    """Return a text, shortened in its middle if it is too long."""
    left = (most - 1) // 2
    return text if len(text) <= most else f"{text[:left]}…{text[len(text) - (most - 1 - left) :]}"


#: 1 January 1980 in ns. Earlier stamps count from the start of a computer or a sensor.
_NO_DATE = 315_532_800_000_000_000


def _lines_of_log(contents: LogContents, found: dict[str, Reading], *, looked: bool) -> Iterator[str]:
    """Yield the table of topics, and the results for topics that were read."""
    yield from wrapped(contents.path)
    yield from wrapped(", ".join(_head(contents)), indent=2)
    topics = [*contents.imu_topics, *(topic for topic in contents.topics if not topic.sensors)]
    if topics:
        yield ""
        yield from _topic_table([_without_repeated_note(topic, found.get(topic.name)) for topic in topics])
    for topic in (topic for topic in topics if is_set("verbose") and topic.fields):
        yield ""
        yield from wrapped(f"Fields of {topic.name}:")
        yield from wrapped(", ".join(topic.fields), indent=2)
    message = set(map(finding_text, contents.findings))
    for topic in contents.imu_topics:
        yield from _what_was_read(topic, found.get(topic.name), message)
    if contents.imu_topics and not looked:
        yield ""
        yield from wrapped(f"Gaps were not checked {_why_not(contents.path)}.")
    if not contents.imu_topics:
        yield ""
        yield from wrapped(_what_to_give(contents))
    for finding in contents.findings:
        yield from wrapped(f"{finding.level} {sentence_of((), finding_text(finding))}", indent=2)
    yield ""


def _what_to_give(contents: LogContents) -> str:
    """Return advice for a log without a readable topic."""
    hint = next(filter(None, (options_for(topic.fixes) for topic in contents.topics)), "")
    wanted = f"No samples can be read this way; give imucal fit {hint}."
    return wanted if hint else "Found no gyroscope or accelerometer."


def _why_not(log: str) -> str:
    """Return why samples were not read, and the option that reads them."""
    if log == STANDARD_INPUT:
        return "on standard input"
    return "in a large log; --gaps reads all samples"


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


def _what_was_read(topic: TopicContents, found: Reading, reported: set[FindingText]) -> Iterator[str]:
    """Yield rate, gaps, units and findings of a topic that was read, without findings of the whole log."""
    if found is None:
        return
    yield ""
    if isinstance(found, str):
        yield from wrapped(f"{topic.name}: {found}")
        return
    for clock in {id(series.clock): series.clock for series in found.series}.values():
        jitter = "" if clock.jitter_s is None else f", {_jitter(clock.jitter_s)}"
        count = f"{len(clock.gaps)} gap{'s' if len(clock.gaps) > 1 else ''}"
        gaps = f"{count}, {clock.missing} missing" if clock.gaps else "no gaps"
        text = f"{topic.name}: {clock.rate_hz:.6g} Hz by {clock.source}, {clock.n} samples, {gaps}{jitter}"
        yield from wrapped(text)
    for question, answer in found.source.decisions:
        # Topics are read by name here, so their choice does not show the choice of `fit`.
        if question not in {"topic", "topics"}:
            yield from wrapped(f"{question}: {answer}", indent=2)
    about: dict[FindingText, list[str]] = {}
    for finding in _findings(found):
        about.setdefault(finding_text(finding), []).extend([finding.axis] if finding.axis else [])
    for own, axes in about.items():
        if own not in reported:
            yield from wrapped(f"{own[0]} {sentence_of(axes, own)}", indent=2)


def _jitter(seconds: float) -> str:
    """Return ``jitter 72 ns``; stamps are whole numbers of ns, so less is no jitter."""
    if seconds < 1e-9:
        return "no jitter"
    unit, in_ns = next(each for each in reversed(TIME_UNITS_NS.items()) if seconds * 1e9 >= each[1])
    return f"jitter {seconds * 1e9 / in_ns:.3g} {unit}"


def _date(ns: int) -> str:
    from datetime import UTC, datetime

    try:
        return datetime.fromtimestamp(ns / 1e9, tz=UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (ValueError, OverflowError, OSError):
        return f"{ns / 1e9:.6g} s"

"""What `imucal info --json` prints of a log."""

from dataclasses import asdict, dataclass

from imucal.findings import Finding
from imucal.readers import LogContents, TopicContents
from imucal.recording import Recording


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicReading:
    """What reading a topic showed: its recording, or why there is none."""

    recording: Recording | None = None
    error: str = ""


def as_json_value(contents: LogContents, found: dict[str, TopicReading]) -> dict[str, object]:
    """Return a log's entry: what it holds, and of the topics that were read their clocks and findings."""
    return {
        "path": contents.path,
        "format": contents.format,
        "compression": contents.compression,
        "size_bytes": contents.size_bytes,
        "start_ns": contents.start_ns,
        "duration_s": contents.duration_s,
        "topics": [_topic_json(topic, found.get(topic.name)) for topic in contents.topics],
        "findings": [_finding_json(finding) for finding in contents.findings],
    }


def _topic_json(topic: TopicContents, found: TopicReading | None) -> dict[str, object]:
    entry: dict[str, object] = {
        **asdict(topic),
        "sensors": [str(sensor) for sensor in topic.sensors],
    }
    if found is None:
        return entry
    if found.recording is None:
        return {**entry, "error": found.error}
    clocks = {series.sensor: series.clock for series in found.recording.series}
    entry["clocks"] = {
        str(sensor): {
            "source": clock.source,
            "rate_hz": clock.rate_hz,
            "samples": clock.n,
            "jitter_s": clock.jitter_s,
            "missing": clock.missing,
            "gaps": [asdict(gap) for gap in clock.gaps],
        }
        for sensor, clock in clocks.items()
    }
    entry["decisions"] = [list(pair) for pair in found.recording.source.decisions]
    entry["findings"] = [_finding_json(finding) for finding in found.recording.findings]
    return entry


def _finding_json(finding: Finding) -> dict[str, object]:
    return {
        "level": finding.level,
        "code": finding.code,
        "axis": finding.axis,
        "text": finding.text,
        "advice": finding.advice,
    }

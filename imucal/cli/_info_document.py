"""What is in a log, as JSON values."""

from dataclasses import asdict

from imucal.cli._topic_reading import TopicReading
from imucal.findings import Finding
from imucal.readers import LogContents, TopicContents

#: What ``--json`` prints follows this.
SCHEMA = "imucal/info/1"


def log_document(contents: LogContents, found: dict[str, TopicReading]) -> dict[str, object]:
    """Return a log's entry: what it holds, and of the topics that were read their clocks and findings."""
    return {
        "path": contents.path,
        "format": contents.format,
        "compression": contents.compression,
        "unpacked_bytes": contents.unpacked_bytes,
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
    return {name: getattr(finding, name) for name in ("level", "code", "axis", "text", "advice")}

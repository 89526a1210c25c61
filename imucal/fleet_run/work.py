"""One log -> its rows in the store. This runs in a child process, which may hang or die."""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from imucal._version import __version__
from imucal.errors import DataError, ImucalError
from imucal.fleet_run.log_identity import Stamp, content_of, edge_of
from imucal.fleet_run.log_places import at_hand
from imucal.fleet_run.log_tasks import FleetSettings, LogTask, has_failed
from imucal.readers.remote_logs import LocalLogs
from imucal.recording import Recording

#: A log's first stamp counts as a date from 2000 on: clocks that start with the sensor begin at 1970.
_FIRST_DATE_NS = 946_684_800 * 10**9
#: Columns that a row of results has of a `imucal.LogValue`.
_OF_VALUE = (
    "value",
    "low",
    "high",
    "variance",
    "variance_sd",
    "variance_growth",
    "level",
    "correlation_time",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogRows:
    """What is committed of a log: rows with the columns of `imucal.fleet.store`."""

    log: dict[str, object]
    results: list[dict[str, object]] = field(default_factory=list)
    bins: list[dict[str, object]] = field(default_factory=list)


def work_on(task: LogTask, settings: FleetSettings) -> LogRows:
    """Read and characterise a log; whatever goes wrong with it is in its row."""
    log = first_row(task, settings)
    wall, cpu = time.perf_counter(), time.process_time()
    rows = LogRows(log=log)
    try:
        with at_hand(task.place) as (logs, stamp):
            if stamp is not None:
                _identify(task, settings, log, logs.paths[0], stamp)
            rows = _characterised(task, settings, log, logs)
        log["status"], log["reason"] = "ok", ""
    except MemoryError:
        log["status"], log["reason"] = "memory", memory_reason(settings)
    except DataError as error:
        log["status"], log["reason"] = "no-data", str(error)
    except (ImucalError, ValueError) as error:
        log["status"], log["reason"] = "unreadable", str(error)
    except OSError as error:
        log["status"], log["reason"] = "unreadable", f"{task.path}: {error.strerror or error}"
    except Exception as error:  # noqa: BLE001 - one log's fault must not cost the others their results
        what = f"{type(error).__name__}: {error}"
        log["status"], log["reason"] = "crash", f"{task.path}: internal error ({what}); please report it"
    log["wall_s"], log["cpu_s"] = time.perf_counter() - wall, time.process_time() - cpu
    log["finished"] = time.time()
    return rows


def first_row(task: LogTask, settings: FleetSettings) -> dict[str, object]:
    """Return what is known of a log before it is looked at; its key is then one of its path."""
    return {
        "key": settings.key(f"path:{task.path}", task.reading),
        "content": "",
        "path": task.path,
        **task.labels,
        "reason": "",
        "findings": [],
        "bytes": task.size,
        "finished": time.time(),
        "report": "",
        "version": __version__,
    }


def memory_reason(settings: FleetSettings) -> str:
    """Return what is said of a log that needs more memory than it may take."""
    return f"it takes more than {settings.memory / 1e9:.3g} GB of memory; give it more, or a part of the log"


def _identify(
    task: LogTask, settings: FleetSettings, log: dict[str, object], path: Path, stamp: Stamp
) -> None:
    content = content_of(path)
    log |= {"bytes": stamp.size, "mtime_ns": stamp.mtime_ns, "edge": edge_of(path), "content": content}
    log["key"] = settings.key(content, task.reading)


def _characterised(
    task: LogTask, settings: FleetSettings, log: dict[str, object], logs: LocalLogs
) -> LogRows:
    from imucal.fitting.bins import pack
    from imucal.fleet import log_values
    from imucal.noise.terms import TERMS
    from imucal.pipeline import Settings, characterize

    recording = logs.named(read_log(logs.paths[0], task.reading))
    wanted = Settings(
        model=settings.model, level=settings.level, bins=True, reading={**task.reading, "path": task.path}
    )
    # One axis at a time: the other processors have other logs.
    report = characterize(recording, wanted, workers=1)
    first = report.axes[0]
    log |= {
        "verdict": report.verdict.grade,
        "findings": sorted({finding.code for finding in report.all_findings if finding.level != "info"}),
        "samples": max(axis.samples for axis in report.axes),
        "seconds": max(axis.duration_s for axis in report.axes),
        "rate_hz": first.rate_hz,
        "started": log.get("started") or _started(recording),
    }
    rows = LogRows(log=log)
    for axis in report.axes:
        where = {"key": log["key"], "sensor": axis.sensor.value, "axis": axis.axis}
        if axis.fit.bins is not None:
            rows.bins.append({**where, "bins": pack(axis.fit.bins)})
        values = log_values("", axis.fit, model=settings.model, level=settings.level)
        for term, value in values.items():
            told = {name: getattr(value, name) for name in _OF_VALUE}
            unit = TERMS[axis.fit[term].symbol].unit(axis.sensor)
            rows.results.append({**where, "term": term, "unit_si": unit, **told})
    if settings.reports == "all" or (settings.reports == "failed" and has_failed("ok", report.verdict.grade)):
        from imucal.report import write_report

        name = f"reports/{log['key']}"
        write_report(report, Path(settings.store) / name, formats=())
        log["report"] = name
    return rows


def read_log(path: str | Path, reading: Mapping[str, object]) -> Recording:
    """Read a log with arguments of `imucal.read`, and leave out what ``skip_s`` and ``take_s`` say."""
    from imucal.readers import read
    from imucal.readers.clocks import part_between

    arguments: dict[str, Any] = dict(reading)
    skip, take = float(arguments.pop("skip_s", 0.0)), arguments.pop("take_s", None)
    recording: Recording = read(path, **arguments)
    if not skip and take is None:
        return recording
    return part_between(recording, skip, float("inf") if take is None else skip + float(take))


def _started(recording: Recording) -> str | None:
    """Return the time of the first sample, in ISO 8601; None where the log has no calendar's clock."""
    stamps = [series.clock.start_ns for series in recording.series if series.clock.start_ns is not None]
    if not stamps or min(stamps) < _FIRST_DATE_NS:
        return None
    return datetime.fromtimestamp(min(stamps) // 10**9, tz=UTC).isoformat()


def enter(folder: str) -> None:
    """Make relative paths begin where the run was started, if this machine has the folder."""
    if os.path.isdir(folder):  # noqa: PTH112 - a text
        os.chdir(folder)

"""One log of a fleet -> its row: read it, fit the given model to every axis, keep the values of all terms."""

import time
from datetime import UTC, datetime
from typing import Any

from imucal._version import __version__
from imucal.errors import DataError, ImucalError
from imucal.fleet.identity import identity_of
from imucal.fleet.logs import LogTask
from imucal.fleet.manifest import LABELS
from imucal.fleet.plan import FleetSettings, has_failed
from imucal.fleet.store import REPORTS, LogRow
from imucal.fleet.values import log_values
from imucal.noise.terms import TERMS
from imucal.pipeline import Settings, characterize
from imucal.readers import read
from imucal.readers.remote_logs import LocalLogs, local_logs
from imucal.recording import Recording
from imucal.remote import is_url
from imucal.remote.stores import identify
from imucal.report.result import Report
from imucal.side_work import try_side_work

#: Clocks that start with the sensor begin in 1970, so earlier stamps are no dates; in ns.
_FIRST_DATE_NS = 946_684_800 * 10**9
#: Stored fields of a `LogValue`.
OF_VALUE = ("value", "low", "high", "variance", "variance_sd", "variance_growth", "level", "correlation_time")


def first_row(task: LogTask, settings: FleetSettings, *, status: str = "", reason: str = "") -> LogRow:
    """Return the row of a log before it is read, with a key from its path; the `reason` has no path."""
    return {
        "key": settings.key(f"path:{task.path}", task.reading),
        "identity": "",
        "path": task.path,
        **{name: task.labels.get(name) for name in LABELS},
        "status": status,
        "reason": reason,
        "code": "",
        "verdict": "",
        "findings": [],
        "samples": None,
        "seconds": None,
        "rate_hz": None,
        "bytes": task.size,
        "cpu_s": 0.0,
        "wall_s": 0.0,
        "finished": time.time(),
        "report": "",
        "version": __version__,
        "terms": [],
    }


def memory_reason(settings: FleetSettings) -> str:
    """Return the reason of a log that needs too much memory."""
    return f"it takes more than {settings.memory / 1e9:.3g} GB of memory; give it more, or a part of the log"


def work_on(task: LogTask, settings: FleetSettings) -> LogRow:
    """Return the row of a log, which contains any error of the log; runs in the process of the log.

    `files` of the row are those of the log's own report.
    """
    row = first_row(task, settings)
    code = ""
    wall = time.perf_counter()
    cpu = time.process_time()
    try:
        place = identify(task.place, keep=False) if is_url(task.place) else task.place
        identity = identity_of(place)
        if identity is not None:
            row |= {"identity": identity.digest, "bytes": identity.size}
            row["key"] = settings.key(identity.digest, task.reading)
        with local_logs([place]) as logs:
            row |= _characterised(task, settings, logs, key=row["key"])
        ended = "ok", ""
    except MemoryError:
        ended = "memory", memory_reason(settings)
    except DataError as error:
        ended = "no-data", f"{error.below(task.path)}"
        code = error.code
    except ImucalError as error:
        ended = "unreadable", f"{error.below(task.path)}"
        code = error.code
    except OSError as error:
        ended = "unreadable", f"{error.strerror or error}"
    except Exception as error:  # noqa: BLE001 - one log's fault must not cost the others their results
        ended = "crash", f"internal error ({type(error).__name__}: {error}); please report it"
    row |= {"status": ended[0], "reason": ended[1], "code": code, "finished": time.time()}
    row |= {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    return row


def _characterised(task: LogTask, settings: FleetSettings, logs: LocalLogs, *, key: str) -> LogRow:
    recording: Recording = logs.named(read(logs.paths[0], **task.reading))
    wanted = Settings(model=settings.model, level=settings.level, reading={**task.reading, "path": task.path})
    # Other processors work on other logs.
    report = characterize(recording, wanted, workers=1)
    row: dict[str, Any] = {
        "verdict": report.verdict.grade,
        "findings": sorted({finding.code for finding in report.all_findings if finding.level != "info"}),
        "samples": max(axis.samples for axis in report.axes),
        "seconds": max(axis.duration_s for axis in report.axes),
        "rate_hz": report.axes[0].rate_hz,
        "started": task.labels.get("started") or _started(recording),
        "terms": _terms(report, settings),
    }
    if settings.reports == "all" or (settings.reports == "failed" and has_failed("ok", report.verdict.grade)):
        row |= {"report": f"{REPORTS}/{key}", "files": _files_of(report)}
    return row


def _terms(report: Report, settings: FleetSettings) -> list[dict[str, Any]]:
    """Return the value of each term of each axis; raises DataError without any, unless it is not noise."""
    # An axis that moved, or of a few samples, has no likelihood.
    fitted = [axis for axis in report.axes if axis.fit.bins is not None]
    if not fitted and report.verdict.grade != "not-noise":
        raise DataError(f"no axis has enough samples for a fit; found {report.axes[0].samples}")
    terms = []
    for axis in fitted:
        values = log_values("", axis.fit, model=settings.model, level=settings.level)
        for term, value in values.items():
            fields = {field: getattr(value, field) for field in OF_VALUE}
            unit = TERMS[axis.fit[term].symbol].unit(axis.sensor)
            where = {"sensor": axis.sensor.value, "axis": axis.axis, "term": term, "unit_si": unit}
            terms.append({**where, **fields})
    return terms


def _files_of(report: Report) -> dict[str, bytes]:
    """Return the files of a log's own report, without pictures; none if they can't be made."""
    from imucal.report.writer import report_files

    files, _ = try_side_work(
        lambda: report_files(report, formats=()), {}, what="its report is missing", code="not-drawn"
    )
    return files


def _started(recording: Recording) -> str | None:
    """Return the time of the first sample in ISO 8601; None if the stamps are not dates."""
    stamps = [series.clock.start_ns for series in recording.series if series.clock.start_ns is not None]
    if not stamps or min(stamps) < _FIRST_DATE_NS:
        return None
    return datetime.fromtimestamp(min(stamps) // 10**9, tz=UTC).isoformat()

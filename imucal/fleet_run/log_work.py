"""Process the logs of a batch in a child process with limits of time and memory, and commit their rows.

If a log hangs, crashes or needs too much memory, only the child ends.
"""

import signal
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeAlias, cast

from imucal._version import __version__
from imucal.errors import DataError, ImucalError, WriteError
from imucal.fleet.store import LABELS, OF_VALUE, FleetStore
from imucal.fleet_run.logs import content_at, edge_at, stamp_of
from imucal.fleet_run.plan import FleetSettings, LogTask, has_failed
from imucal.processes import ChildProcess
from imucal.readers.remote_logs import LocalLogs, local_logs
from imucal.recording import Recording
from imucal.remote import is_url
from imucal.remote.stores import identify
from imucal.resources import MEMORY, POOLS, THREADS

#: Another log may be the cause of a process's end.
_ATTEMPTS = 2
#: Exit code of a child in which an allocation of Rust or C++ failed.
_ABORTED = -signal.SIGABRT
#: Reading a log may use the memory of the child divided by this.
_SHARE = 4
#: Clocks that start with the sensor begin in 1970, so earlier stamps are no dates.
_FIRST_DATE_NS = 946_684_800 * 10**9

#: A row of the table of logs, with its rows of the tables ``results`` and ``bins``.
LogRow: TypeAlias = dict[str, Any]


def work_on_batch(settings: FleetSettings, tasks: Sequence[LogTask], child: ChildProcess) -> int:
    """Process logs in a child process, commit all or none, and return how many failed.

    Raises WriteError.
    """
    return commit([_work_in_child(task, settings, child) for task in tasks], settings)


def commit(rows: Sequence[LogRow], settings: FleetSettings) -> int:
    """Commit the rows of logs; return how many have no usable numbers."""
    results, bins = ([one for row in rows for one in row.get(name, ())] for name in ("results", "bins"))
    FleetStore(settings.store).commit(rows, results, bins, shard=str(settings.shard[0]))
    return sum(has_failed(row["status"], row.get("verdict")) for row in rows)


def first_row(task: LogTask, settings: FleetSettings, *, status: str = "", reason: str = "") -> LogRow:
    """Return the row of a log before it is read, with a key from its path; the `reason` has no path."""
    return {
        "key": settings.key(f"path:{task.path}", task.reading),
        "content": "",
        "path": task.path,
        **{name: task.labels.get(name) for name in LABELS},
        "status": status,
        "reason": reason,
        "code": "",
        "findings": [],
        "bytes": task.size,
        "finished": time.time(),
        "report": "",
        "version": __version__,
    }


def _memory_reason(settings: FleetSettings) -> str:
    return f"it takes more than {settings.memory / 1e9:.3g} GB of memory; give it more, or a part of the log"


def child_process(settings: FleetSettings) -> ChildProcess:
    """Return a child process with one thread in all libraries and its share of memory."""
    # Dask makes its workers return all memory at once; to allocate it again costs a fifth of a fit.
    environment = {
        "MALLOC_TRIM_THRESHOLD_": None,
        **dict.fromkeys((THREADS, *POOLS), "1"),
        MEMORY: str(settings.memory // _SHARE),
        "MPLBACKEND": "agg",
    }
    folder = settings.folder if Path(settings.folder).is_dir() else None
    return ChildProcess(environment=environment, counted="data", folder=folder)


def _work_in_child(task: LogTask, settings: FleetSettings, child: ChildProcess) -> LogRow:
    seconds, status = settings.patience(task), "crash"
    for _ in range(_ATTEMPTS):
        try:
            answer = child.ask(work_on, task, settings, seconds=seconds, memory=settings.memory)
        except OSError as error:
            start = f"its process can't be started ({error.strerror or error}), as on an overloaded machine"
            why = f"{start}; run again when it is less loaded"
            break
        if isinstance(answer.value, WriteError):
            raise answer.value
        if answer.outcome == "done":
            return cast("LogRow", answer.value)
        if answer.outcome == "late":
            status = "timeout"
            why = f"it took more than {seconds:.4g} s; give it more time, or a part of the log"
            break
        if answer.outcome == "no-memory" or answer.code == _ABORTED:
            status, why = "memory", _memory_reason(settings)
            break
        if answer.outcome == "failed":
            why = f"internal error ({answer.words}); please report it"
        else:
            how = signal.Signals(-answer.code).name if answer.code < 0 else f"exit code {answer.code}"
            why = f"its process ended {_ATTEMPTS} times ({how}), as when the machine has no memory left"
    row = first_row(task, settings, status=status, reason=why)
    # Limits may differ between logs, but their excess is one kind of failure.
    return row | {"code": status if status in {"memory", "timeout"} else ""}


def work_on(task: LogTask, settings: FleetSettings) -> LogRow | WriteError:
    """Read and characterise a log in the child process; its row contains any error of the log.

    Returns a WriteError if the report can't be written, which is not an error of the log.
    """
    log = first_row(task, settings)
    code = ""
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        place = identify(task.place, keep=False) if is_url(task.place) else task.place
        with local_logs([place]) as logs:
            if (stamp := stamp_of(place)) is not None:
                path = str(logs.paths[0])
                content = content_at(path)
                log |= {"bytes": stamp.size, "mtime_ns": stamp.mtime_ns, "edge": edge_at(path)}
                log |= {"content": content, "key": settings.key(content, task.reading)}
            log |= _characterised(task, settings, logs, key=log["key"])
        ended = "ok", ""
    except MemoryError:
        ended = "memory", _memory_reason(settings)
    except WriteError as error:
        return error
    except DataError as error:
        ended = "no-data", f"{error.below(task.path)}"
        code = error.code
    except ImucalError as error:
        ended = "unreadable", f"{error.below(task.path)}"
        code = error.code
    except ValueError as error:
        ended = "unreadable", str(error)
    except OSError as error:
        ended = "unreadable", error.strerror or str(error)
    except Exception as error:  # noqa: BLE001 - one log's fault must not cost the others their results
        ended = "crash", f"internal error ({type(error).__name__}: {error}); please report it"
    log |= {"status": ended[0], "reason": ended[1], "code": code, "finished": time.time()}
    log |= {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    return log


def _characterised(task: LogTask, settings: FleetSettings, logs: LocalLogs, *, key: str) -> LogRow:
    from imucal.fitting.bins import pack
    from imucal.fleet import log_values
    from imucal.noise.terms import TERMS
    from imucal.pipeline import Settings, characterize
    from imucal.readers import read

    recording: Recording = logs.named(read(logs.paths[0], **task.reading))
    wanted = Settings(model=settings.model, level=settings.level, reading={**task.reading, "path": task.path})
    # Other processors work on other logs.
    report = characterize(recording, wanted, workers=1)
    results, bins, name = [], [], ""
    for axis in report.axes:
        where = {"key": key, "sensor": axis.sensor.value, "axis": axis.axis}
        if axis.fit.bins is not None:
            bins.append({**where, "bins": pack(axis.fit.bins)})
        values = log_values("", axis.fit, model=settings.model, level=settings.level)
        for term, value in values.items():
            fields = {field: getattr(value, field) for field in OF_VALUE}
            unit = TERMS[axis.fit[term].symbol].unit(axis.sensor)
            results.append({**where, "term": term, "unit_si": unit, **fields})
    if settings.reports == "all" or (settings.reports == "failed" and has_failed("ok", report.verdict.grade)):
        from imucal.report import write_report

        name = f"reports/{key}"
        write_report(report, Path(settings.store) / name, formats=())
    return {
        "verdict": report.verdict.grade,
        "findings": sorted({finding.code for finding in report.all_findings if finding.level != "info"}),
        "samples": max(axis.samples for axis in report.axes),
        "seconds": max(axis.duration_s for axis in report.axes),
        "rate_hz": report.axes[0].rate_hz,
        "started": task.labels.get("started") or _started(recording),
        "report": name,
        "results": results,
        "bins": bins,
    }


def _started(recording: Recording) -> str | None:
    """Return the time of the first sample in ISO 8601; None if the stamps are not dates."""
    stamps = [series.clock.start_ns for series in recording.series if series.clock.start_ns is not None]
    if not stamps or min(stamps) < _FIRST_DATE_NS:
        return None
    return datetime.fromtimestamp(min(stamps) // 10**9, tz=UTC).isoformat()

"""Output and types of options that the fleet commands share."""

import re
import sys
from collections.abc import Sized
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._printing import echo, print_findings, print_note, wrapped
from imucal.cli.param_types import Text
from imucal.grading import GRADE_TEXTS, GRADES
from imucal.remote import is_url
from imucal.units import data_size, duration
from imucal.user_input import seconds_of

if TYPE_CHECKING:
    import polars as pl

    from imucal.findings import Finding
    from imucal.fleet.store import FleetStore
    from imucal.fleet_report import Fleet
    from imucal.fleet_report.answers import Ask
    from imucal.fleet_run import FleetPlan

_NAMED = 3


def print_plan(plan: "FleetPlan", workers: int) -> None:
    """Print one line per log, with its state and labels; then the total and the expected time."""
    for log in plan.own():
        labels = " ".join(f"{name}={value}" for name, value in log.labels.items())
        copy = f"same content as {log.copy_of}" if log.copy_of else ""
        echo("\t".join((log.state, log.path, *filter(None, (labels, copy)))))
    tasks = plan.tasks
    seconds = sum(task.seconds for task in tasks) / workers
    about = duration(seconds, rough=True)
    size = data_size(sum(task.size for task in tasks))
    echo(f"{number_of(tasks, 'log')}, {size}, about {about} on {number_of(workers, 'worker')}", err=True)


def print_summary(plan: "FleetPlan", store: "FleetStore") -> None:
    """Print the number of logs to do, the duplicates, and advice if no log has a unit label."""
    copies = [log for log in plan.own() if log.copy_of]
    done, again = plan.own("done"), plan.own("again")
    parts = {
        f"{number_of(plan.tasks, 'log')} to do, {data_size(sum(task.size for task in plan.tasks))}": True,
        f"{len(done)} already done": done,
        f"{len(again)} to try again": again,
        f"{number_of(copies, 'copy', 'copies')} of other logs, counted once": copies,
    }
    print_note("; ".join(text for text, message in parts.items() if message))
    for log in copies:
        print_note(f"  {log.path}: same content as {log.copy_of}")
    # A run without labels keeps those in the store.
    if not any(log.labels.get("unit") for log in plan.logs) and not store.logs()["unit"].count():
        example = "label the units with --labels '{model}/{unit}/*.mcap'"
        print_note(f"No log has the label unit, so logs are not grouped; {example}")


def conclude(plan: "FleetPlan", out: Path, *, ask: "Ask", max_failed: float) -> None:
    """Print the results of the logs of this run; exit with code 3 if none is readable, 4 if too many failed.

    Write the report if no log of the manifest is left, unless the report is newer than the store.
    """
    from imucal.fleet.store import FleetStore
    from imucal.fleet_report import load_fleet

    store = FleetStore(out.absolute())
    counted = {log.copy_of or log.path for log in plan.own()}
    every = store.logs()
    logs = every.filter(every["path"].is_in(sorted(counted)))
    print_standing(logs, out)
    failed = print_failures(logs)
    asked = store.manifest()
    waiting = set(asked.filter(asked["copy_of"].is_null())["path"]) - set(every["path"])
    if every.filter(status="ok").height and not waiting:
        page, last = (store.folder / name for name in ("fleet.html", "fleet.json"))
        if page.is_file() and last.is_file() and last.stat().st_mtime_ns > store.changed_ns():
            echo(str(page))
        else:
            write_files(load_fleet(store.folder, ask=ask), page_alone=True)
    readable = logs.height - sum(status not in {"ok", "no-data"} for status in logs["status"])
    if logs.height and not readable:
        echo(f"Error: {out}: none of {number_of(logs.height, 'log')} can be read", err=True)
        raise click.exceptions.Exit(3)
    if failed > max_failed * max(logs.height, 1):
        percent = f"{100 * failed / logs.height:.3g} %"
        share = f"{failed} of {number_of(logs.height, 'log')} failed ({percent})"
        echo(f"Error: {out}: {share}, more than --max-failed {100 * max_failed:g}%", err=True)
        raise click.exceptions.Exit(4)


def write_files(
    fleet: "Fleet", *, page_alone: bool = False, html: bool = True, pictures: bool = True
) -> None:
    """Write the report of a fleet; print its files (or only the page), its findings, and odd units.

    Without a terminal, the sentence about odd units is one line, which is easier to search.
    """
    from imucal.fleet_report import write_fleet
    from imucal.fleet_report.pages import verdict

    missing: list[Finding] = []
    files = write_fleet(fleet, html=html, pictures=pictures, on_finding=missing.append)
    page = next((file for file in files if file.suffix == ".html"), files[0])
    for file in [page] if page_alone else files:
        echo(str(file))
    print_findings([*fleet.findings, *missing])
    text = verdict(fleet)[1]
    for line in wrapped(text) if sys.stderr.isatty() else [text]:
        print_note(line)


def print_standing(logs: "pl.DataFrame", folder: Path) -> None:
    """Print the number of logs per result, and their size and time."""
    from imucal.fleet.store import STATUSES

    counts = [f"{count(logs, 'ok', grade)} {GRADE_TEXTS[grade]}" for grade in GRADES]
    counts += [f"{n} {status}" for status in STATUSES if status != "ok" and (n := count(logs, status))]
    echo(f"{folder}: {number_of(logs.height, 'log')} done: {', '.join(counts)}")
    cpu, size = float(logs["cpu_s"].sum() or 0.0), int(logs["bytes"].sum() or 0)
    if cpu:
        echo(f"{data_size(size)} in {duration(cpu)} of one core, {size / cpu / 1e6:.3g} MB/s")


def print_failures(logs: "pl.DataFrame") -> int:
    """Print the logs without usable numbers, the first of each kind of failure; return how many failed."""
    from imucal.fleet_run.plan import has_failed

    groups: dict[str, list[str]] = {}
    for path, status, verdict, reason in logs.select("path", "status", "verdict", "reason").iter_rows():
        if has_failed(status, verdict):
            kind, why = ("not noise", "not noise") if status == "ok" else (status, reason)
            groups.setdefault(kind, []).append(f"{path}: {why}")
    for kind, texts in groups.items():
        print_note(f"{kind}: {len(texts)}")
        for text in texts[:_NAMED]:
            print_note(f"  {text}")
        if len(texts) > _NAMED:
            print_note(f"  and {len(texts) - _NAMED} more")
    return sum(map(len, groups.values()))


def number_of(things: int | Sized, one: str, many: str = "") -> str:
    """Return ``1 log``, ``2 logs``."""
    number = things if isinstance(things, int) else len(things)
    return f"{number} {one if number == 1 else many or one + 's'}"


def count(logs: "pl.DataFrame", status: str, verdict: str | None = None) -> int:
    """Return the number of logs with a status and a verdict."""
    return logs.filter(status=status, **({} if verdict is None else {"verdict": verdict})).height


def _patience(text: str) -> float | None:
    if text == "auto":
        return None
    if not (seconds := seconds_of(text)):
        raise ValueError("'0' is not a time limit; write a time such as 10min, or auto")
    return seconds


def _shard(text: str) -> tuple[int, int]:
    """Return i and n of ``i/n``; i starts at 1."""
    match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text.strip())
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise ValueError(f"{text!r} is not a part; write I/N with I from 1 to N, such as 1/8")
    return int(match[1]), int(match[2])


PATIENCE = Text("duration", _patience)
SHARD = Text("shard", _shard)


def is_fleet(path: str | Path) -> bool:
    """Return whether a path is the folder of a fleet; a URL never is."""
    return not is_url(path) and (Path(path) / "manifest.parquet").is_file()


def read_fleet(path: str | Path, model: str | None) -> "Fleet":
    """Load one sensor model of a fleet without its logs."""
    from imucal.fleet_report.summary import load_model

    return load_model(path, model)

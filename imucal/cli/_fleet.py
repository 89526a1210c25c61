"""Output and types of options that the fleet commands share."""

import re
import sys
from collections.abc import Sequence, Sized
from dataclasses import replace
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
    from imucal.findings import Finding
    from imucal.fleet.plan import FleetPlan
    from imucal.fleet.store import LogRow
    from imucal.fleet.summary import Fleet

#: Failures of each kind that are listed.
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


def print_summary(plan: "FleetPlan") -> None:
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
    stored = plan.stored.logs() if plan.stored else []
    if not any(log.labels.get("unit") for log in plan.logs) and not any(row["unit"] for row in stored):
        example = "label the units with --labels '{model}/{unit}/*.mcap'"
        print_note(f"No log has the label unit, so logs are not grouped; {example}")


def conclude(plan: "FleetPlan", out: Path, *, max_failed: float) -> None:
    """Print the results of the logs of this run; exit with code 3 if none is readable, 4 if too many failed.

    Write the report if no requested log is left.
    """
    from imucal.fleet.store import read_store
    from imucal.fleet.summary import load_fleet

    folder = out.absolute()
    stored = read_store(folder)
    counted = {log.copy_of or log.path for log in plan.own()}
    every = stored.logs()
    logs = [row for row in every if row["path"] in counted]
    print_standing(logs, out)
    failed = print_failures(logs)
    waiting = {log.path for log in stored.asked.values() if not log.copy_of} - {row["path"] for row in every}
    if count(every, "ok") and not waiting:
        write_files(load_fleet(folder), page_alone=True)
    readable = count(logs, "ok") + count(logs, "no-data")
    if logs and not readable:
        echo(f"Error: {out}: none of {number_of(logs, 'log')} can be read", err=True)
        raise click.exceptions.Exit(3)
    if failed > max_failed * max(len(logs), 1):
        percent = f"{100 * failed / len(logs):.3g} %"
        share = f"{failed} of {number_of(logs, 'log')} failed ({percent})"
        echo(f"Error: {out}: {share}, more than --max-failed {100 * max_failed:g}%", err=True)
        raise click.exceptions.Exit(4)


def write_files(
    fleet: "Fleet", *, page_alone: bool = False, html: bool = True, pictures: bool = True
) -> None:
    """Write the report of a fleet; print its files (or only the page), its findings, and odd units.

    Without a terminal, the sentence about odd units is one line, which is easier to search.
    """
    from imucal.fleet.files import write_fleet
    from imucal.fleet.page import verdict

    missing: list[Finding] = []
    files = write_fleet(fleet, html=html, pictures=pictures, on_finding=missing.append)
    page = next((file for file in files if file.suffix == ".html"), files[0])
    for file in [page] if page_alone else files:
        echo(str(file))
    print_findings(missing)
    text = verdict(fleet)[1]
    for line in wrapped(text) if sys.stderr.isatty() else [text]:
        print_note(line)


def print_standing(logs: "Sequence[LogRow]", folder: Path) -> None:
    """Print the number of logs per result, and their size and time."""
    from imucal.fleet.store import STATUSES

    counts = [f"{count(logs, 'ok', grade)} {GRADE_TEXTS[grade]}" for grade in GRADES]
    counts += [f"{n} {status}" for status in STATUSES if status != "ok" and (n := count(logs, status))]
    echo(f"{folder}: {number_of(logs, 'log')} done: {', '.join(counts)}")
    cpu, size = sum(row["cpu_s"] for row in logs), sum(row["bytes"] for row in logs)
    if cpu:
        echo(f"{data_size(size)} in {duration(cpu)} of one core, {size / cpu / 1e6:.3g} MB/s")


def print_failures(logs: "Sequence[LogRow]") -> int:
    """Print the logs without usable numbers, the first of each kind of failure; return how many failed."""
    from imucal.fleet.plan import has_failed

    groups: dict[str, list[str]] = {}
    for row in logs:
        status = row["status"]
        if has_failed(status, row["verdict"]):
            kind, why = ("not noise", "not noise") if status == "ok" else (status, row["reason"])
            groups.setdefault(kind, []).append(f"{row['path']}: {why}")
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


def count(logs: "Sequence[LogRow]", status: str, verdict: str | None = None) -> int:
    """Return the number of logs with a status and a verdict."""
    return sum(row["status"] == status and verdict in {None, row["verdict"]} for row in logs)


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
    from imucal.fleet import store

    return not is_url(path) and store.is_fleet(path)


def read_fleet(path: str | Path, model: str | None) -> "Fleet":
    """Load a fleet, and refuse it if it has several sensor models and none is named, or not this one."""
    from imucal.fleet.summary import load_fleet

    fleet = load_fleet(path)
    return replace(fleet, models=(fleet.model(model),))

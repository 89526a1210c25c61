"""``imucal fleet``: the commands for many logs of many units."""

import contextlib
import itertools
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from imucal.cli import LazyGroup
from imucal.cli._fleet import (
    PATIENCE,
    SHARD,
    conclude,
    count,
    number_of,
    print_failures,
    print_plan,
    print_standing,
    print_summary,
    write_files,
)
from imucal.cli._printing import as_typed, echo, fleet_progress, print_json, print_note
from imucal.cli.context import misuse
from imucal.cli.options import (
    MODEL,
    OUTPUT,
    SAMPLES,
    Command,
    flag,
    logs_argument,
    option,
    out_option,
    quiet,
    reading_options,
    skip,
    take,
    topic,
    unwrapped,
)
from imucal.cli.param_types import FILE, LEVEL, PATH, SHARE, Number
from imucal.errors import ImucalError
from imucal.grading import GRADES

_COMMANDS = {
    "run": ("fleet:run", "Fit one noise model to many logs, on this machine or a cluster."),
    "report": ("fleet:report", "Describe the units of each sensor model: page, JSON, CSV."),
    "status": ("fleet:status", "List the logs that are done, failed or left."),
}


_EPILOG = unwrapped("""
Examples:
  imucal fleet run logs --labels '{model}/{unit}/*.mcap' -o fleet
  imucal fleet status fleet
  imucal fleet report fleet
""")


@click.group(
    cls=LazyGroup,
    table=_COMMANDS,
    of_a_log=("characterise a fleet", "imucal fleet run PATH"),
    of_a_result={"fleet": ("print the state of a fleet", "imucal fleet status PATH")},
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=_EPILOG,
)
def command() -> None:
    """Characterise many logs of many units, and each sensor model.

    `imucal fleet run LOGS…` fits the same noise model to every log and keeps the results in a folder.
    """


#: Copies of the defaults in `imucal.fleet.plan`, whose import would slow down --help.
_MODEL = "N + B + K"
_LEVEL = 0.95


_RUN_EPILOG = unwrapped("""
Examples:
  imucal fleet run logs --labels '{model}/{unit}/*.mcap' -o fleet
  imucal fleet run --manifest units.csv --jobs 8 --memory 2GB
  imucal fleet run 'logs/**/*.bag' --dry-run
  imucal fleet run logs --scheduler tls://head:8786
  imucal fleet run logs --shard 3/8        (the third of eight such runs)
  imucal fleet run -o fleet                (continue with the rest)

Exit codes: 0 done, 2 usage, 3 no log can be read, 4 more logs failed than
--max-failed, 5 the store can't be written or the workers are gone,
130 interrupted. Run the command again to continue.
""")


@click.command(cls=Command, epilog=_RUN_EPILOG)
@logs_argument("LOGS...", required=False)
@option(
    "--manifest",
    metavar="CSV",
    type=FILE,
    help="Read logs from a table with the column path; optional: model, unit, temperature_c, started, "
    "arguments of imucal.read.",
)
@option("--labels", metavar="TEXT", help="Take labels from the paths, such as '{model}/{unit}/*.mcap'.")
@option(
    "--jobs",
    metavar="N",
    type=click.IntRange(1, 4096),
    help="Number of logs to fit in parallel. [default: number of processors]",
)
@option(
    "--scheduler", metavar="ADDRESS", help="Use the Dask scheduler of a cluster, such as tls://head:8786."
)
@option("--shard", metavar="I/N", type=SHARD, help="Do part I of N of the logs.")
@option("--memory", metavar="SIZE", help="Memory limit per log, such as 2GB.")
@option(
    "--timeout",
    "timeout_s",
    metavar="TIME",
    type=PATIENCE,
    default="auto",
    show_default=True,
    help="Time limit per log, such as 10min.",
)
@option(
    "--reports",
    type=click.Choice(["none", "failed", "all"]),
    default="failed",
    show_default=True,
    help="Keep reports of these logs.",
)
@flag("--fresh", help="Discard the results in the folder and do every log again.")
@option(
    "--max-failed",
    metavar="SHARE",
    type=Number(0, 1, percent=True),
    default="5%",
    show_default=True,
    help="Exit with code 4 if more than this share of logs fails.",
)
@flag("--dry-run", help="Print the plan without writing anything.")
@out_option(
    "DIR",
    default="fleet",
    show_default=True,
    help="Write the results to DIR; logs already in it are skipped.",
)
@quiet
@topic
@skip
@take
@reading_options
@flag("--strict", group=SAMPLES, help="Refuse damaged logs.")
@option("--model", group=MODEL, metavar="TEXT", help=f"Fit these terms to every log. [default: {_MODEL}]")
@option(
    "--level",
    group=MODEL,
    metavar="P",
    type=LEVEL,
    help=f"Confidence level of every interval. [default: {_LEVEL}]",
)
def run(
    *,
    logs: tuple[str, ...],
    out: Path,
    manifest: Path | None,
    labels: str | None,
    model: str | None,
    level: float | None,
    jobs: int | None,
    scheduler: str | None,
    shard: tuple[int, int] | None,
    memory: str | None,
    timeout_s: float | None,
    reports: str,
    fresh: bool,
    max_failed: float,
    dry_run: bool,
    topic: tuple[str, ...],
    reading: dict[str, Any],
    skip_s: float,
    take_s: float | None,
    strict: bool,
) -> None:
    """Fit the same noise model to each of many LOGS, and keep the results in a folder.

    LOGS are files, folders of any depth, names with wildcards, URLs, or - for a list on standard
    input. Each log is a separate recording. Label the units by the paths (--labels) or a table
    (--manifest). Finished logs are kept. The same command again does the rest, also after a crash.
    Changed logs are fitted again; duplicate files count once.
    """
    from imucal.fleet.on_dask import unprotected
    from imucal.fleet.plan import fleet_settings, planned
    from imucal.fleet.running import run_plan
    from imucal.fleet.store import is_fleet

    if not (logs or manifest or is_fleet(out)):
        misuse("Missing argument 'LOGS...'; name logs, or give --manifest CSV or the folder of a fleet (-o)")
    given = {
        "labels": labels,
        "model": model,
        "level": level,
        "jobs": jobs,
        "scheduler": scheduler,
        "shard": shard,
        "memory": memory,
        "timeout_s": timeout_s,
        "reports": reports,
        "fresh": fresh,
        "reading": {**reading, "topic": topic, "skip_s": skip_s, "take_s": take_s, "strict": strict},
    }
    settings = fleet_settings(out, given)
    lists = ([line.strip() for line in sys.stdin] if name == "-" else [name] for name in logs)
    names = list(filter(None, itertools.chain.from_iterable(lists)))
    plan = planned(settings, names, manifest=manifest, dry=dry_run, notify=print_note)
    if dry_run:
        print_plan(plan, settings.jobs)
        return
    print_summary(plan)
    if warned := unprotected(settings.scheduler):
        echo(f"warning: {warned}", err=True)
    with _how_to_continue(out):
        with fleet_progress(when=bool(plan.tasks)) as progress:
            run_plan(plan, settings, progress=progress or (lambda _: None))
        conclude(plan, out, max_failed=max_failed)


@contextlib.contextmanager
def _how_to_continue(out: Path) -> Iterator[None]:
    """If a run ends early, print the command to continue: as typed, without what must not be repeated."""
    from imucal.remote import addresses

    try:
        yield
    except (KeyboardInterrupt, ImucalError):
        typed = click.get_current_context().obj or ()
        kept = [addresses.shown(word) for word in typed if word not in {"--fresh", "-"}]
        resume = shlex.join(["imucal", *(kept or ["fleet", "run", "-o", str(out)])])
        echo(f"Finished logs are kept; to continue: {resume}", err=True)
        raise


_REPORT_EPILOG = unwrapped("""
Examples:
  imucal fleet report fleet
  imucal fleet report fleet --content 0.99 --no-html
  imucal export fleet --to kalibr

Exit codes: 0 done, 2 usage, 3 the folder is not a fleet or can't be read,
4 no log is done, 5 a file can't be written.
""")


@click.command(cls=Command, epilog=_REPORT_EPILOG)
@click.argument("folder", metavar="FLEET", type=PATH)
@option(
    "--content",
    metavar="P",
    type=SHARE,
    default=0.95,
    show_default=True,
    help="Share of all units that the tolerance bound contains.",
)
@option(
    "--confidence",
    metavar="P",
    type=SHARE,
    default=0.95,
    show_default=True,
    help="Confidence level of the tolerance bound.",
)
@option("--html/--no-html", default=True, help="Write fleet.html.")
@option("--pictures/--no-pictures", default=True, help="Write the pictures (PNG).")
@quiet
def report(*, folder: Path, content: float, confidence: float, html: bool, pictures: bool) -> None:
    """Describe the units of each sensor model in FLEET, the folder of 'imucal fleet run'.

    The report tells whether a unit is unlike the others. Per model, axis and term it contains: the units
    with their intervals, the range of the next unit, the number for the config of every unit (the
    tolerance bound), the median unit, and the spread between units and between logs of one unit.
    """
    from imucal.fleet.summary import load_fleet

    fleet = load_fleet(folder, content=content, confidence=confidence)
    write_files(fleet, html=html, pictures=pictures)
    if fleet.loose:
        print_note(f"to count them, run the fleet with --labels '{fleet.labels}'")


_STATUS_EPILOG = unwrapped("""
Examples:
  imucal fleet status fleet
  imucal fleet status fleet --json | jq .left
""")


@click.command(cls=Command, epilog=_STATUS_EPILOG)
@click.argument("folder", metavar="FLEET", type=PATH)
@flag("--json", "as_json", group=OUTPUT, help="Print the status as JSON on standard output.")
@quiet
def status(*, folder: Path, as_json: bool) -> None:
    """List the logs of FLEET that are done, failed or left, also during a run."""
    from imucal.fleet.store import STATUSES, read_store

    stored = read_store(folder)
    stored.refuse_damage()
    logs = stored.logs()
    copies = {log.path: log.copy_of for log in stored.asked.values() if log.copy_of}
    settled = {*(row["path"] for row in logs), *copies}
    left = sorted(stored.asked.keys() - settled)
    if as_json:
        document = {
            "asked": len(stored.asked),
            "done": len(logs),
            "statuses": {status: count(logs, status) for status in STATUSES},
            "verdicts": {grade: count(logs, "ok", grade) for grade in GRADES},
            "copies": copies,
            "left": left,
            "bytes": sum(row["bytes"] for row in logs),
            "cpu_s": sum(row["cpu_s"] for row in logs),
        }
        print_json(document)
        return
    print_standing(logs, folder)
    print_failures(logs)
    for path, other in copies.items():
        print_note(f"  {path}: same content as {other}, counted once")
    if left:
        left_of = f"{len(left)} of {number_of(stored.asked, 'log')}"
        echo(f"left: {left_of}; to continue: imucal fleet run -o {as_typed(folder)}")

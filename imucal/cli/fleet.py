"""``imucal fleet``: the commands for many logs of many units."""

import contextlib
import itertools
import shlex
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from imucal.cli import LazyGroup
from imucal.cli._declared import argument, declared, flag, misuse, option, together
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
from imucal.cli.parameters import DURATION, FILE, LEVEL, PATH, QUIET, READING, SHARE, TOPIC, Asked, Number
from imucal.errors import ImucalError
from imucal.grading import GRADES

_COMMANDS = {
    "run": ("fleet:run", "Fit one noise model to many logs, on this machine or a cluster."),
    "report": ("fleet:report", "Describe the units of each sensor model: page, JSON, CSV."),
    "status": ("fleet:status", "List the logs that are done, failed or left."),
}


@click.group(
    cls=LazyGroup,
    table=_COMMANDS,
    of_a_log=("characterise a fleet", "imucal fleet run PATH"),
    of_a_result={"fleet": ("print the state of a fleet", "imucal fleet status PATH")},
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  imucal fleet run logs --labels '{model}/{unit}/*.mcap' -o fleet
  imucal fleet status fleet
  imucal fleet report fleet""",
)
def command() -> None:
    """Characterise many logs of many units, and each sensor model.

    `imucal fleet run LOGS…` fits the same noise model to every log and keeps the results in a folder.
    """


#: Copies of the defaults in `imucal.fleet_run.plan`, whose import would slow down --help.
_MODEL, _LEVEL = "N + B + K", 0.95


def _any_number(parameter: click.Parameter) -> None:
    """Let the LOG argument accept any number of logs, or none."""
    if isinstance(parameter, click.Argument):
        parameter.metavar, parameter.required = "LOGS...", False


@declared
def run(
    *,
    out: Path = option("-o --out DIR=fleet  Write the results to DIR; logs already in it are skipped.", PATH),
    manifest: Path | None = option(
        "--manifest CSV  Read logs from a table with the column path; optional: model, unit, "
        "temperature_c, started, arguments of imucal.read.",
        FILE,
    ),
    given: dict[str, Any] = together(
        dict,
        {
            "labels": option("--labels TEXT  Take labels from the paths, such as '{model}/{unit}/*.mcap'."),
            "model": option(f"--model TEXT  Fit these terms to every log. [default: {_MODEL}]"),
            "level": option(f"--level P  Confidence level of every interval. [default: {_LEVEL}]", LEVEL),
            "jobs": option(
                "--jobs N  Number of logs to fit in parallel. [default: number of processors]",
                click.IntRange(1, 4096),
            ),
            "scheduler": option(
                "--scheduler ADDRESS  Use the Dask scheduler of a cluster, such as tls://head:8786."
            ),
            "shard": option("--shard I/N  Do part I of N of the logs.", SHARD),
            "memory": option("--memory SIZE  Memory limit per log, such as 2GB."),
            "timeout_s": option("--timeout TIME=auto  Time limit per log, such as 10min.", PATIENCE),
            "reports": option(
                "--reports=failed  Keep reports of these logs.", click.Choice(["none", "failed", "all"])
            ),
            "fresh": flag("--fresh  Discard the results in the folder and do every log again."),
        },
    ),
    max_failed: float = option(
        "--max-failed SHARE=5%  Exit with code 4 if more than this share of logs fails.",
        Number(0, 1, percent=True),
    ),
    dry_run: bool = flag("--dry-run  Print the plan without writing anything."),
    topic: tuple[str, ...] = TOPIC,
    asked: Asked = replace(READING, change=_any_number),
    part: dict[str, object] = together(
        dict,
        {
            "skip_s": option("--skip TIME  Skip the start of each log, such as 5min.", DURATION, default=0.0),
            "take_s": option("--take TIME  Read only this much of each log, such as 2h.", DURATION),
            "strict": flag("--strict  Refuse damaged logs."),
        },
    ),
    _quiet: bool = QUIET,
) -> None:
    """Fit the same noise model to each of many LOGS, and keep the results in a folder.

    LOGS are files, folders of any depth, names with wildcards, URLs, or - for a list on standard
    input. Each log is a separate recording. Label the units by the paths (--labels) or a table
    (--manifest). Finished logs are kept. The same command again does the rest, also after a crash.
    Changed logs are fitted again; duplicate files count once.

    Examples::
      imucal fleet run logs --labels '{model}/{unit}/*.mcap' -o fleet
      imucal fleet run --manifest units.csv --jobs 8 --memory 2GB
      imucal fleet run 'logs/**/*.bag' --dry-run
      imucal fleet run logs --scheduler tls://head:8786
      imucal fleet run logs --shard 3/8        (the third of eight such runs)
      imucal fleet run -o fleet                (continue with the rest)

    Exit codes: 0 done, 2 usage, 3 no log can be read, 4 more logs failed than
    --max-failed, 5 the store can't be written or the workers are gone,
    130 interrupted. Run the command again to continue.
    """
    from imucal.fleet.store import FleetStore
    from imucal.fleet_run import fleet_settings, planned, prepare
    from imucal.fleet_run.on_dask import unprotected
    from imucal.fleet_run.running import asking, run_plan

    if not (asked.logs or manifest or FleetStore(out).exists):
        misuse("Missing argument 'LOGS...'; name logs, or give --manifest CSV or the folder of a fleet (-o)")
    reading = {**asked.options, "topic": topic, **part}
    settings = fleet_settings(out, {**given, "reading": reading})
    lists = ([line.strip() for line in sys.stdin] if name == "-" else [name] for name in asked.logs)
    names = list(filter(None, itertools.chain.from_iterable(lists)))
    plan = planned(settings, names, manifest=manifest, dry=dry_run, notify=print_note)
    if dry_run:
        print_plan(plan, settings.jobs)
        return
    prepare(plan, settings)
    print_summary(plan, FleetStore(out))
    if warned := unprotected(settings.scheduler):
        echo(f"warning: {warned}", err=True)
    with _how_to_continue(out):
        with fleet_progress(when=bool(plan.tasks)) as progress:
            run_plan(plan, settings, progress=progress or (lambda _: None))
        conclude(plan, out, ask=asking(settings), max_failed=max_failed)


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


@declared
def report(
    *,
    folder: Path = argument("FLEET", PATH),
    content: float = option("--content P=0.95  Share of all units that the tolerance bound covers.", SHARE),
    confidence: float = option("--confidence P=0.95  Confidence level of the tolerance bound.", SHARE),
    html: bool = option("--html/--no-html  Write fleet.html.", default=True),
    pictures: bool = option("--pictures/--no-pictures  Write the pictures (PNG).", default=True),
    _quiet: bool = QUIET,
) -> None:
    """Describe the units of each sensor model in FLEET, the folder of 'imucal fleet run'.

    Per model, axis and term, the report contains: the units with their intervals, the median unit, the
    spread between units and between logs of one unit, the range of the next unit, and the number for
    the config of every unit (the tolerance bound) with the savings from more units. Odd units are named.

    Examples::
      imucal fleet report fleet
      imucal fleet report fleet --content 0.99 --no-html
      imucal export fleet --value tolerance --to kalibr

    Exit codes: 0 done, 2 usage, 3 the folder is not a fleet or can't be read,
    4 no log is done, 5 a file can't be written.
    """
    from imucal.fleet_report import load_fleet

    fleet = load_fleet(folder, content=content, confidence=confidence)
    write_files(fleet, html=html, pictures=pictures)
    if fleet.loose:
        print_note(f"to count them, run the fleet with --labels '{fleet.labels}'")


@declared
def status(
    *,
    folder: Path = argument("FLEET", PATH),
    as_json: bool = flag("--json  Print the status as JSON on standard output."),
    _quiet: bool = QUIET,
) -> None:
    """List the logs of FLEET that are done, failed or left, also during a run.

    Examples::
      imucal fleet status fleet
      imucal fleet status fleet --json | jq .left
    """
    from imucal.fleet.store import STATUSES, FleetStore

    store = FleetStore(folder)
    manifest = store.manifest()
    store.refuse_damage()
    logs = store.logs()
    copies = dict(manifest.drop_nulls("copy_of").select("path", "copy_of").iter_rows())
    settled = {*logs["path"], *copies}
    left = [path for path in manifest["path"] if path not in settled]
    if as_json:
        document = {
            "asked": manifest.height,
            "done": logs.height,
            "statuses": {status: count(logs, status) for status in STATUSES},
            "verdicts": {grade: count(logs, "ok", grade) for grade in GRADES},
            "copies": copies,
            "left": left,
            "bytes": int(logs["bytes"].sum() or 0),
            "cpu_s": float(logs["cpu_s"].sum() or 0.0),
        }
        print_json(document)
        return
    print_standing(logs, folder)
    print_failures(logs)
    for path, other in copies.items():
        print_note(f"  {path}: same content as {other}, counted once")
    if left:
        left_of = f"{len(left)} of {number_of(manifest.height, 'log')}"
        echo(f"left: {left_of}; to continue: imucal fleet run -o {as_typed(folder)}")

"""``imucal fleet``: the commands for many logs of many units.

``run`` fits one noise model to many logs; ``report`` says what the units of a fleet are like; ``status`` what
of it is done.
"""

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
    say_plan,
    write_files,
)
from imucal.cli._printing import as_typed, echo, fleet_progress, print_json, say
from imucal.cli.parameters import DURATION, FILE, LEVEL, PATH, QUIET, READING, SHARE, TOPIC, Asked, Number
from imucal.errors import ImucalError
from imucal.grading import GRADES

#: Command -> module that holds it, and the line that --help prints.
_COMMANDS = {
    "run": ("fleet:run", "Fit one noise model to many logs, on this machine or a cluster."),
    "report": ("fleet:report", "Say what the units of each sensor model are like: page, JSON, CSV."),
    "status": ("fleet:status", "Say what of a fleet is done, what failed and why, what is left."),
}


@click.group(
    cls=LazyGroup,
    table=_COMMANDS,
    of_a_log=("characterise a fleet", "run"),
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  imucal fleet run logs --labels '{model}/{unit}/*.mcap' -o fleet
  imucal fleet status fleet
  imucal fleet report fleet""",
)
def command() -> None:
    """Characterise many logs of many units, and the model of the sensor that they are units of.

    `imucal fleet run LOGS…` fits the same noise model to every log and keeps the results in a folder.
    """


#: As `imucal.fleet_run.plan` has them; to load that for a help text would take longer than the text.
_MODEL, _LEVEL = "N + B + K", 0.95


def _any_number(parameter: click.Parameter) -> None:
    """Let the LOG argument be one for many logs, or none."""
    if isinstance(parameter, click.Argument):
        parameter.metavar, parameter.required = "LOGS...", False


@declared
def run(
    *,
    out: Path = option("-o --out DIR=fleet  Folder of the fleet; what it has is not done again.", PATH),
    manifest: Path | None = option(
        "--manifest CSV  Table with a column path; model, unit, temperature_c, started; arguments of "
        "imucal.read.",
        FILE,
    ),
    given: dict[str, Any] = together(
        dict,
        {
            "labels": option("--labels TEXT  Labels in paths, such as '{model}/{unit}/*.mcap'."),
            "model": option(f"--model TEXT  Terms, for every log. [default: {_MODEL}]"),
            "level": option(f"--level  Confidence level of every interval. [default: {_LEVEL}]", LEVEL),
            "jobs": option("--jobs N  Logs at a time. [default: all processors]", click.IntRange(1, 4096)),
            "scheduler": option("--scheduler ADDRESS  Dask scheduler of a cluster, such as tls://head:8786."),
            "shard": option("--shard I/N  Do part I of N, log by log.", SHARD),
            "memory": option("--memory SIZE  Memory of each log, such as 2GB."),
            "timeout_s": option("--timeout TIME=auto  Time of each log, such as 10min.", PATIENCE),
            "reports": option("--reports=failed  Reports of logs.", click.Choice(["none", "failed", "all"])),
            "fresh": flag("--fresh  Forget what the folder has, and do every log anew."),
        },
    ),
    max_failed: float = option(
        "--max-failed SHARE=5%  Share of logs that may fail before the exit code is 4.",
        Number(0, 1, percent=True),
    ),
    dry_run: bool = flag("--dry-run  Print what would be done; write nothing."),
    topic: tuple[str, ...] = TOPIC,
    asked: Asked = replace(READING, change=_any_number),
    part: dict[str, object] = together(
        dict,
        {
            "skip_s": option("--skip TIME  Leave out the start of each log.", DURATION, default=0.0),
            "take_s": option("--take TIME  Use only so much of each log, such as 2h.", DURATION),
            "strict": flag("--strict  Refuse damaged logs."),
        },
    ),
    _quiet: bool = QUIET,
) -> None:
    """Fit the same noise model to every one of many LOGS, and keep the results in a folder.

    LOGS are files, folders of any depth, names with wildcards, URLs, or - for a list on standard
    input. Each log is by itself. Units need labels: from the paths (--labels) or a table
    (--manifest). What is done is kept: the same command again does what is left, also after a
    crash; a log that was changed is done anew, and a content that stands twice counts once.

    Examples::
      imucal fleet run logs --labels '{model}/{unit}/*.mcap' -o fleet
      imucal fleet run --manifest units.csv --jobs 8 --memory 2GB
      imucal fleet run 'logs/**/*.bag' --dry-run
      imucal fleet run logs --scheduler tls://head:8786
      imucal fleet run logs --shard 3/8        (the third of eight such runs)
      imucal fleet run -o fleet                (go on with what is left)

    Exit codes: 0 done, 2 usage, 3 no log can be read, 4 more logs failed than
    --max-failed, 5 the store can't be written or the workers are gone,
    130 interrupted. Run it again to go on: what is done stays done.
    """
    from imucal.fleet.store import FleetStore
    from imucal.fleet_run import fleet_settings, planned, prepare
    from imucal.fleet_run.on_dask import unprotected
    from imucal.fleet_run.running import asking, run_plan

    if not (asked.logs or manifest or FleetStore(out).exists):
        misuse("Missing argument 'LOGS...'; name logs, give a --manifest, or -o the folder of a fleet")
    reading = {**asked.options, "topic": topic, **part}
    settings = fleet_settings(out, {**given, "reading": reading})
    lists = ([line.strip() for line in sys.stdin] if name == "-" else [name] for name in asked.logs)
    names = list(filter(None, itertools.chain.from_iterable(lists)))
    plan = planned(settings, names, manifest=manifest, dry=dry_run, say=say)
    if dry_run:
        print_plan(plan, settings.jobs)
        return
    prepare(plan, settings)
    say_plan(plan, FleetStore(out))
    if warned := unprotected(settings.scheduler):
        echo(f"warning: {warned}", err=True)
    with _saying_how_to_go_on(out):
        with fleet_progress(when=bool(plan.tasks)) as progress:
            run_plan(plan, settings, tell=progress or (lambda _: None))
        conclude(plan, out, ask=asking(settings), max_failed=max_failed)


@contextlib.contextmanager
def _saying_how_to_go_on(out: Path) -> Iterator[None]:
    """Print the command that goes on where a run ends early: as typed, less what must not be done again."""
    from imucal.remote import addresses

    try:
        yield
    except (KeyboardInterrupt, ImucalError):
        typed = click.get_current_context().obj or ()
        kept = [addresses.shown(word) for word in typed if word not in {"--fresh", "-"}]
        resume = shlex.join(["imucal", *(kept or ["fleet", "run", "-o", str(out)])])
        echo(f"What is done is kept; to go on: {resume}", err=True)
        raise


@declared
def report(
    *,
    folder: Path = argument("FLEET", PATH),
    content: float = option("--content=0.95  Share of all units that the tolerance bound holds.", SHARE),
    confidence: float = option("--confidence=0.95  How sure that is.", SHARE),
    html: bool = option("--html/--no-html  Write fleet.html.", default=True),
    pictures: bool = option("--pictures/--no-pictures  Write the PNGs.", default=True),
    _quiet: bool = QUIET,
) -> None:
    """Say what the units of each sensor model are like: FLEET is the folder of 'imucal fleet run'.

    Per model, axis and term: the units with their intervals, the median unit, the spreads between units and
    between logs of one unit, where the next unit lies, and the number for the config of every unit (the
    tolerance bound) with what more units would save. Units that are odd or drift are named.

    Examples::
      imucal fleet report fleet
      imucal fleet report fleet --content 0.99 --no-html
      imucal export fleet --value tolerance --to kalibr

    Exit codes: 0 done, 2 usage, 3 the folder is no fleet or can't be read,
    4 no log is done, 5 a file can't be written.
    """
    from imucal.fleet_report import load_fleet

    fleet = load_fleet(folder, content=content, confidence=confidence)
    write_files(fleet, html=html, pictures=pictures)
    if fleet.loose:
        say(f"to have them counted, run the fleet with --labels '{fleet.labels}'")


@declared
def status(
    *,
    folder: Path = argument("FLEET", PATH),
    as_json: bool = flag("--json  Print it as JSON."),
    _quiet: bool = QUIET,
) -> None:
    """Say what of FLEET is done, what failed and why, and what is left; while it runs, too.

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
        say(f"  {path}: same content as {other}, counted once")
    if left:
        left_of = f"{len(left)} of {number_of(manifest.height, 'log')}"
        echo(f"left: {left_of}; imucal fleet run -o {as_typed(folder)} goes on")

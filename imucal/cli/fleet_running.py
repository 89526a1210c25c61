"""``imucal fleet run``: one noise model for many logs."""

import contextlib
import itertools
import shlex
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from imucal.cli._declared import declared, flag, misuse, option, shown, together
from imucal.cli._fleet import PATIENCE, SHARD, conclude, print_plan, say_plan
from imucal.cli._printing import say
from imucal.cli._progress import fleet_progress
from imucal.cli.parameters import DURATION, FILE, LEVEL, PATH, QUIET, READING, TOPIC, Asked, Number
from imucal.errors import ImucalError

#: As `imucal.fleet_run.plan` has them; to load that for a help text would take longer than the text.
_MODEL, _LEVEL = "N + B + K", 0.95


def _any_number(parameter: click.Parameter) -> None:
    """Let the LOG argument be one for many logs, or none."""
    if isinstance(parameter, click.Argument):
        parameter.metavar, parameter.required = "LOGS...", False


@declared(
    epilog="""\b
Examples:
  imucal fleet run logs --labels '{model}/{unit}/*.mcap' -o fleet
  imucal fleet run --manifest units.csv --jobs 8 --memory 2GB
  imucal fleet run 'logs/**/*.bag' --dry-run
  imucal fleet run logs --scheduler tcp://head:8786
  imucal fleet run logs --shard 3/8        (the third of eight such runs)
  imucal fleet run -o fleet                (go on with what is left)

\b
Exit codes: 0 done, 2 usage, 3 no log can be read, 4 more logs failed than
--max-failed, 5 the store can't be written or the workers are gone,
130 interrupted. Run it again to go on: what is done stays done."""
)
def command(
    *,
    out: Path = shown(
        "-o --out", Path("fleet"), "Folder of the fleet; what it has is not done again.", PATH, "DIR"
    ),
    manifest: Path | None = option(
        "--manifest",
        "Table with a column path; model, unit, temperature_c, started; arguments of imucal.read.",
        FILE,
        "CSV",
    ),
    given: dict[str, Any] = together(
        dict,
        {
            "labels": option("--labels", "Labels in paths, such as '{model}/{unit}/*.mcap'.", metavar="TEXT"),
            "model": option("--model", f"Terms, for every log. [default: {_MODEL}]", metavar="TEXT"),
            "level": option("--level", f"Confidence level of every interval. [default: {_LEVEL}]", LEVEL),
            "jobs": option(
                "--jobs", "Logs at a time. [default: all processors]", click.IntRange(1, 4096), "N"
            ),
            "scheduler": option(
                "--scheduler", "Dask scheduler of a cluster, such as tcp://head:8786.", metavar="ADDRESS"
            ),
            "shard": option("--shard", "Do part I of N, log by log.", SHARD, "I/N"),
            "memory": option("--memory", "Memory of each log, such as 2GB.", metavar="SIZE"),
            "timeout_s": shown("--timeout", "auto", "Time of each log, such as 10min.", PATIENCE, "TIME"),
            "reports": shown(
                "--reports", "failed", "Reports of logs.", click.Choice(["none", "failed", "all"])
            ),
            "fresh": flag("--fresh", "Forget what the folder has, and do every log anew."),
        },
    ),
    max_failed: float = shown(
        *("--max-failed", "5%", "Share of logs that may fail before the exit code is 4."),
        *(Number(0, 1, percent=True), "SHARE"),
    ),
    dry_run: bool = flag("--dry-run", "Print what would be done; write nothing."),
    topic: tuple[str, ...] = TOPIC,
    asked: Asked = replace(READING, change=_any_number),
    part: dict[str, object] = together(
        dict,
        {
            "skip_s": option("--skip", "Leave out the start of each log.", DURATION, "TIME", default=0.0),
            "take_s": option("--take", "Use only so much of each log, such as 2h.", DURATION, "TIME"),
            "strict": flag("--strict", "Refuse damaged logs."),
        },
    ),
    quiet: bool = QUIET,
) -> None:
    """Fit the same noise model to every one of many LOGS, and keep the results in a folder.

    LOGS are files, folders of any depth, names with wildcards, URLs, or - for a list on standard
    input. Each log is by itself. Units need labels: from the paths (--labels) or a table
    (--manifest). What is done is kept: the same command again does what is left, also after a
    crash; a log that was changed is done anew, and a content that stands twice counts once.
    """
    from imucal.fleet.store import FleetStore
    from imucal.fleet_run import fleet_settings, planned, prepare
    from imucal.fleet_run.on_dask import unprotected
    from imucal.fleet_run.running import asking, run_plan

    if not (asked.logs or manifest or FleetStore(out).exists):
        misuse("Missing argument 'LOGS...'; name logs, give a --manifest, or -o the folder of a fleet")
    reading = {**asked.options, "topic": topic, **part}
    settings = fleet_settings(out, {**given, "reading": reading})
    tell = partial(say, quiet=quiet)
    lists = ([line.strip() for line in sys.stdin] if name == "-" else [name] for name in asked.logs)
    names = list(filter(None, itertools.chain.from_iterable(lists)))
    plan = planned(settings, names, manifest=manifest, dry=dry_run, say=tell)
    if dry_run:
        print_plan(plan, settings.jobs)
        return
    prepare(plan, settings)
    say_plan(plan, FleetStore(out), quiet=quiet)
    if warned := unprotected(settings.scheduler):
        say(f"warning: {warned}")
    with _saying_how_to_go_on(out):
        with fleet_progress(quiet=quiet or not plan.tasks) as progress:
            run_plan(plan, settings, tell=progress or (lambda _: None))
        conclude(plan, out, ask=asking(settings), max_failed=max_failed, quiet=quiet)


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
        say(f"What is done is kept; to go on: {resume}")
        raise

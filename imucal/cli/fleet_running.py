"""``imucal fleet run``: one noise model for many logs."""

import contextlib
import shlex
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._declared import declared, flag, misuse, option, shown, together
from imucal.cli._fleet import FIXED_STRUCTURE, LABELS, PATIENCE, SHARD, SIZE, conclude, print_plan, say_plan
from imucal.cli._printing import say
from imucal.cli._progress import fleet_progress
from imucal.cli.parameters import DURATION, FILE, LEVEL, PATH, QUIET, READING, TOPIC, Asked, Number
from imucal.errors import ImucalError
from imucal.resources import threads

if TYPE_CHECKING:
    from imucal.fleet.store import FleetStore
    from imucal.fleet_run.logs import LabelPattern
    from imucal.fleet_run.plan import LogTask

#: As `imucal.fleet_run.plan` has them; to load that for a help text would take longer than the text.
_MODEL, _LEVEL = "N + B + K", 0.95


def _entries(
    store: "FleetStore",
    logs: tuple[str, ...],
    manifest: Path | None,
    labels: "LabelPattern | None",
    *,
    quiet: bool,
) -> list["LogTask"]:
    """Return the logs asked for; those of the store's manifest where none is named."""
    from imucal.fleet_run.plan import asked_logs

    if not (logs or manifest is not None or store.exists):
        misuse("Missing argument 'LOGS...'; name logs, give a --manifest, or -o the folder of a fleet")
    listed = sys.stdin if "-" in logs else ()
    asked, unlike = asked_logs(store, logs, listed=listed, manifest=manifest, labels=labels)
    if unlike and labels is not None:
        say(f"{unlike} of {len(asked)} logs do not fit {labels.pattern}", quiet=quiet)
    return asked


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
    labels: "LabelPattern | None" = option(
        "--labels", "Labels in paths, such as '{model}/{unit}/*.mcap'.", LABELS, "TEXT"
    ),
    model: str | None = option(
        "--model", f"Terms, for every log. [default: {_MODEL}]", FIXED_STRUCTURE, "TEXT"
    ),
    level: float | None = option(
        "--level", f"Confidence level of every interval. [default: {_LEVEL}]", LEVEL
    ),
    jobs: int | None = option(
        "--jobs", "Logs at a time. [default: all processors]", click.IntRange(1, 4096), "N"
    ),
    scheduler: str | None = option(
        "--scheduler", "Dask scheduler of a cluster, such as tcp://head:8786.", metavar="ADDRESS"
    ),
    shard: tuple[int, int] | None = option("--shard", "Do part I of N, log by log.", SHARD, "I/N"),
    memory: int | None = option("--memory", "Memory of each log, such as 2GB.", SIZE, "SIZE"),
    timeout: float = shown("--timeout", "auto", "Time of each log, such as 10min.", PATIENCE, "TIME"),
    reports: str = shown("--reports", "failed", "Reports of logs.", click.Choice(["none", "failed", "all"])),
    max_failed: float = shown(
        *("--max-failed", "5%", "Share of logs that may fail before the exit code is 4."),
        *(Number(0, 1, percent=True), "SHARE"),
    ),
    fresh: bool = flag("--fresh", "Forget what the folder has, and do every log anew."),
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
    from imucal.fleet_run import plan_fleet
    from imucal.fleet_run.fleet_call import fleet_settings, prepare
    from imucal.fleet_run.on_dask import unprotected
    from imucal.fleet_run.plan import as_json
    from imucal.fleet_run.running import asking, run_plan

    if shard and scheduler:
        misuse("--shard works without a cluster; give --shard or --scheduler, not both")
    ctx, store = click.get_current_context(), FleetStore(out.absolute())
    workers = 1 if shard else jobs or threads()
    try:
        settings = fleet_settings(
            store,
            model=model,
            level=level,
            fresh=fresh,
            workers=workers,
            memory=memory,
            timeout=None if timeout < 0 else timeout,
            reports=reports,
            shard=shard,
        )
    except ValueError as error:
        misuse(f"{error}; choose another folder with -o, or start anew with --fresh")
    if not fresh:
        _mend(store, dry_run=dry_run, quiet=quiet)
    entries = _entries(store, asked.logs, manifest, labels, quiet=quiet)
    options = as_json({**asked.options, "topic": topic, **part})
    plan = plan_fleet(entries, settings, None if fresh else store, reading=options)
    plan = plan.shard(*shard) if shard else plan
    if dry_run:
        print_plan(plan, workers)
        return
    prepare(store, plan, settings, fresh=fresh)
    say_plan(plan, store, quiet=quiet)
    if warned := unprotected(scheduler):
        say(f"warning: {warned}")
    ask = asking(settings, workers=workers, scheduler=scheduler)
    with _saying_how_to_go_on(ctx, out):
        with fleet_progress(quiet=quiet or not plan.tasks) as progress:
            run_plan(plan, settings, workers=workers, scheduler=scheduler, tell=progress or (lambda _: None))
        conclude(ctx, store, plan, out, ask=ask, max_failed=max_failed, quiet=quiet)


def _mend(store: "FleetStore", *, dry_run: bool, quiet: bool) -> None:
    """Remove what is damaged, and say so; a run that writes nothing refuses it."""
    if dry_run:
        store.refuse_damage()
    for part in store.mend():
        say(f"{part}: is damaged; what it held is done again", quiet=quiet)


@contextlib.contextmanager
def _saying_how_to_go_on(ctx: click.Context, out: Path) -> Iterator[None]:
    """Print the command that goes on where a run ends early: as typed, less what must not be done again."""
    from imucal.remote import addresses

    try:
        yield
    except (KeyboardInterrupt, ImucalError):
        kept = [addresses.shown(word) for word in ctx.obj or () if word not in {"--fresh", "-"}]
        resume = shlex.join(["imucal", *(kept or ["fleet", "run", "-o", str(out)])])
        say(f"What is done is kept; to go on: {resume}")
        raise

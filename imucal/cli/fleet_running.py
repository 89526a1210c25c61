"""``imucal fleet run``: one noise model for many logs."""

import contextlib
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._fleet import FIXED_STRUCTURE, LABELS, PATIENCE, SHARD, SIZE, conclude, print_plan, say_plan
from imucal.cli._printing import say
from imucal.cli._progress import fleet_progress
from imucal.cli.parameters import DURATION, LEVEL, Number, quiet_option, reading_options, shown, topic_option
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
        msg = "Missing argument 'LOGS...'; name logs, give a --manifest, or -o the folder of a fleet"
        raise click.UsageError(msg)
    listed = sys.stdin if "-" in logs else ()
    asked, unlike = asked_logs(store, logs, listed=listed, manifest=manifest, labels=labels)
    if unlike and labels is not None:
        say(f"{unlike} of {len(asked)} logs do not fit {labels.pattern}", quiet=quiet)
    return asked


@click.command(
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
@click.argument("logs", metavar="LOGS...", nargs=-1, type=click.Path(allow_dash=True, readable=False))
@shown(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    default=Path("fleet"),
    metavar="DIR",
    help="Folder of the fleet; what it has is not done again.",
)
@click.option(
    "--manifest",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="CSV",
    help="Table with a column path; model, unit, temperature_c, started; arguments of imucal.read.",
)
@click.option(
    "--labels", type=LABELS, metavar="TEXT", help="Labels in paths, such as '{model}/{unit}/*.mcap'."
)
@click.option(
    "--model", type=FIXED_STRUCTURE, metavar="TEXT", help=f"Terms, for every log. [default: {_MODEL}]"
)
@click.option("--level", type=LEVEL, help=f"Confidence level of every interval. [default: {_LEVEL}]")
@click.option(
    "--jobs", type=click.IntRange(1, 4096), metavar="N", help="Logs at a time. [default: all processors]"
)
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler of a cluster, such as tcp://head:8786.")
@click.option("--shard", type=SHARD, metavar="I/N", help="Do part I of N, log by log.")
@click.option("--memory", type=SIZE, metavar="SIZE", help="Memory of each log, such as 2GB.")
@shown("--timeout", type=PATIENCE, default="auto", metavar="TIME", help="Time of each log, such as 10min.")
@shown("--reports", type=click.Choice(["none", "failed", "all"]), default="failed", help="Reports of logs.")
@shown(
    "--max-failed",
    type=Number(0, 1, percent=True),
    default="5%",
    metavar="SHARE",
    help="Share of logs that may fail before the exit code is 4.",
)
@click.option("--fresh", is_flag=True, help="Forget what the folder has, and do every log anew.")
@click.option("--dry-run", is_flag=True, help="Print what would be done; write nothing.")
@topic_option
@reading_options
@click.option(
    "--skip", "skip_s", type=DURATION, default=0.0, metavar="TIME", help="Leave out the start of each log."
)
@click.option(
    "--take", "take_s", type=DURATION, metavar="TIME", help="Use only so much of each log, such as 2h."
)
@click.option("--strict", is_flag=True, help="Refuse damaged logs.")
@quiet_option
@click.pass_context
def command(
    ctx: click.Context,
    *,
    logs: tuple[str, ...],
    out: Path,
    manifest: Path | None,
    labels: "LabelPattern | None",
    model: str | None,
    level: float | None,
    jobs: int | None,
    scheduler: str | None,
    shard: tuple[int, int] | None,
    memory: int | None,
    timeout: float,
    reports: str,
    max_failed: float,
    fresh: bool,
    dry_run: bool,
    topic: tuple[str, ...],
    reading: dict[str, object],
    skip_s: float,
    take_s: float | None,
    strict: bool,
    quiet: bool,
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
        msg = "--shard works without a cluster; give --shard or --scheduler, not both"
        raise click.UsageError(msg)
    store = FleetStore(out.absolute())
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
        msg = f"{error}; choose another folder with -o, or start anew with --fresh"
        raise click.UsageError(msg) from error
    if not fresh:
        _mend(store, dry_run=dry_run, quiet=quiet)
    entries = _entries(store, logs, manifest, labels, quiet=quiet)
    options = {**reading, "topic": topic, "skip_s": skip_s, "take_s": take_s, "strict": strict}
    plan = plan_fleet(entries, settings, None if fresh else store, reading=as_json(options))
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

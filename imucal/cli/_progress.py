"""Progress bars, on a terminal that somebody watches and nowhere else."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imucal.fleet_run.running import RunCount

#: Columns of a terminal that has room for a bar, bytes and the time left beside the words.
_WIDE = 80


@contextmanager
def reading_progress(*, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Show bytes, rate and time left on a terminal; nothing elsewhere."""
    with _bar("reading", "DownloadColumn", "TransferSpeedColumn", quiet=quiet) as update:
        yield update and (lambda done, total: update(completed=done, total=total))


@contextmanager
def download_progress(*, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Show bytes, rate and time left of a download on a terminal; nothing elsewhere."""
    with _bar("downloading", "DownloadColumn", "TransferSpeedColumn", quiet=quiet) as update:
        yield update and (lambda done, total: update(completed=done, total=total or None))


@contextmanager
def axes_progress(*, quiet: bool) -> Iterator[Callable[[int, int, str], None] | None]:
    """Show which axis is being fitted, on a terminal; nothing elsewhere."""
    with _bar("fitting {task.fields[axis]:8}", "MofNCompleteColumn", quiet=quiet) as update:
        yield update and (lambda done, total, name: update(completed=done, total=total, axis=name))


@contextmanager
def smoothing_progress(axis: str, *, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Show how much of an axis has been decomposed, on a terminal; nothing elsewhere."""
    with _bar(f"decomposing {axis}", "TaskProgressColumn", quiet=quiet) as update:
        yield update and (lambda done, total: update(completed=done, total=total))


@contextmanager
def fleet_progress(*, quiet: bool) -> Iterator[Callable[["RunCount"], None] | None]:
    """Show logs done, failed and in hand, bytes and time left on a terminal; nothing elsewhere."""
    text = "{task.fields[axis]}"
    with _bar(text, "DownloadColumn", quiet=quiet) as update:
        yield update and (
            lambda count: update(
                # A byte at least, so that logs of unknown size are seen too.
                completed=count.done_size + count.done,
                total=count.size + count.logs,
                axis=f"{count.done} of {count.logs} logs, {count.failed} failed, {count.running} in hand",
            )
        )


@contextmanager
def _bar(text: str, *columns: str, quiet: bool) -> Iterator[Callable[..., None] | None]:
    """Yield what updates a bar with some of rich's columns, or None where nobody watches."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from functools import partial

    from rich import progress
    from rich.console import Console
    from rich.table import Column

    console = Console(stderr=True)
    said = progress.TextColumn(text, table_column=Column(no_wrap=True))
    if console.width < _WIDE:
        shown: list[progress.ProgressColumn] = [said, progress.TaskProgressColumn()]
    else:
        own = [getattr(progress, name)() for name in columns]
        shown = [said, progress.BarColumn(bar_width=20), *own, progress.TimeRemainingColumn()]
    with progress.Progress(*shown, console=console, transient=True) as bar:
        yield partial(bar.update, bar.add_task("", total=None, axis=""))

"""Progress bars, on a terminal that somebody watches and nowhere else."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from imucal.fleet_run.running import RunCount

#: What a bar yields: called with what is done, of what, and a word; None where nobody watches.
_Update: TypeAlias = Callable[..., None] | None
#: Columns of a terminal that has room for a bar, bytes and the time left beside the words.
_WIDE = 80
#: Columns of bytes.
_BYTES = ("DownloadColumn", "TransferSpeedColumn")


def reading_progress(*, quiet: bool) -> AbstractContextManager[_Update]:
    """Show bytes, rate and time left on a terminal; nothing elsewhere."""
    return _bar("reading", *_BYTES, quiet=quiet)


def download_progress(*, quiet: bool) -> AbstractContextManager[_Update]:
    """Show bytes, rate and time left of a download on a terminal; nothing elsewhere."""
    return _bar("downloading", *_BYTES, quiet=quiet)


def axes_progress(*, quiet: bool) -> AbstractContextManager[_Update]:
    """Show which axis is being fitted, on a terminal; nothing elsewhere."""
    return _bar("fitting {task.fields[word]:8}", "MofNCompleteColumn", quiet=quiet)


def smoothing_progress(axis: str, *, quiet: bool) -> AbstractContextManager[_Update]:
    """Show how much of an axis has been decomposed, on a terminal; nothing elsewhere."""
    return _bar(f"decomposing {axis}", "TaskProgressColumn", quiet=quiet)


@contextmanager
def fleet_progress(*, quiet: bool) -> Iterator[Callable[["RunCount"], None] | None]:
    """Show logs done, failed and in hand, bytes and time left on a terminal; nothing elsewhere."""
    with _bar("{task.fields[word]}", "DownloadColumn", quiet=quiet) as update:
        yield update and (
            lambda count: update(
                # A byte at least, so that logs of unknown size are seen too.
                count.done_size + count.done,
                count.size + count.logs,
                f"{count.done} of {count.logs} logs, {count.failed} failed, {count.running} in hand",
            )
        )


@contextmanager
def _bar(text: str, *columns: str, quiet: bool) -> Iterator[_Update]:
    """Yield what updates a bar with some of rich's columns, or None where nobody watches."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
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
        task = bar.add_task("", total=None, word="")
        yield lambda done, total, word="": bar.update(task, completed=done, total=total or None, word=word)

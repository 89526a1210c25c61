"""Progress bars, on a terminal that somebody watches and nowhere else."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from imucal.fleet_run.running import RunCount

#: What a bar yields: called with what is done, of what, and a word; None where nobody watches.
_Update: TypeAlias = Callable[..., None] | None
#: Columns of a terminal that has room for a bar, bytes and the time left beside the words.
_WIDE = 80
#: Columns of bytes.
BYTES = ("DownloadColumn", "TransferSpeedColumn")
#: The bar that shows which axis is being fitted.
FITTING = ("fitting {task.fields[word]:8}", "MofNCompleteColumn")


@contextmanager
def progress(text: str, *columns: str, quiet: bool) -> Iterator[_Update]:
    """Yield what updates a bar with some of rich's columns, or None where nobody watches."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich import progress as bars
    from rich.console import Console
    from rich.table import Column

    console = Console(stderr=True)
    said = bars.TextColumn(text, table_column=Column(no_wrap=True))
    if console.width < _WIDE:
        shown: list[bars.ProgressColumn] = [said, bars.TaskProgressColumn()]
    else:
        own = [getattr(bars, name)() for name in columns]
        shown = [said, bars.BarColumn(bar_width=20), *own, bars.TimeRemainingColumn()]
    with bars.Progress(*shown, console=console, transient=True) as bar:
        task = bar.add_task("", total=None, word="")
        yield lambda done, total, word="": bar.update(task, completed=done, total=total or None, word=word)


@contextmanager
def fleet_progress(*, quiet: bool) -> Iterator[Callable[["RunCount"], None] | None]:
    """Show logs done, failed and in hand, bytes and time left on a terminal; nothing elsewhere."""
    with progress("{task.fields[word]}", "DownloadColumn", quiet=quiet) as update:
        yield update and (
            lambda count: update(
                # A byte at least, so that logs of unknown size are seen too.
                count.done_size + count.done,
                count.size + count.logs,
                f"{count.done} of {count.logs} logs, {count.failed} failed, {count.running} in hand",
            )
        )

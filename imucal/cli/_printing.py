"""Print texts that fit the terminal, findings and progress; end commands with an error."""

import json
import shlex
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import click

from imucal.cli.context import is_set
from imucal.errors import DataError, Fix
from imucal.findings import Finding, options_to_keep
from imucal.grading import NoiseVerdict, refusal
from imucal.printable import printable, printable_json

if TYPE_CHECKING:
    from imucal.fleet.running import RunCount


def echo(text: str, *, err: bool = False) -> None:
    """Print text for people, with control characters escaped."""
    click.echo(printable(text), err=err)


def print_json(document: object, *, indent: int = 2, ascii_only: bool = True) -> None:
    """Print a document as JSON on standard output; control characters are JSON escapes."""
    text = json.dumps(document, indent=indent, ensure_ascii=ascii_only, allow_nan=False)
    click.echo(printable_json(text))


def can_print(text: str, encoding: str | None = None) -> bool:
    """Return whether an encoding, by default the one of standard output, can represent a text."""
    try:
        text.encode(encoding or sys.stdout.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def picked(value: object, names: str) -> dict[str, object]:
    """Return attributes of a value as JSON values."""
    from imucal.report import typed_json

    return typed_json.picked(value, names)


def print_note(text: object) -> None:
    """Print a line for people on standard error, because standard output contains only results."""
    if not is_set("quiet"):
        echo(str(text), err=True)


#: Columns of the widest table, which fits a terminal, a mail and a log of CI.
FULL = 80
_MIN_WIDTH = 30


def width() -> int:
    """Return the columns of the terminal, 30 to 80; 80 if the output is no terminal."""
    return max(_MIN_WIDTH, min(FULL, shutil.get_terminal_size((FULL, 24)).columns))


def wrapped(text: str, *, indent: int = 0) -> list[str]:
    """Break a text into lines that fit the terminal; existing line breaks are kept."""
    lines = []
    for line in text.rstrip().split("\n"):
        own = indent + len(line) - len(line.lstrip())
        lines += textwrap.wrap(
            line,
            width(),
            initial_indent=" " * own if line.strip() else "",
            subsequent_indent=" " * (own + 2),
            break_on_hyphens=False,
        ) or [""]
    return lines


#: Level, code and sentence.
FindingText: TypeAlias = tuple[str, str, str]
_STYLES: dict[str, str] = {"error": "bold red", "warning": "yellow", "info": "cyan"}


def finding_text(finding: Finding) -> FindingText:
    """Return level, code and sentence of a finding: its text, the advice, and the option."""
    option = f"Try {options_to_keep(finding.keep_s)}." if finding.keep_s else ""
    if finding.fix and finding.fix.argument == "columns":
        option = "Use --columns."
    sentence = " ".join(filter(None, (finding.text, finding.advice, option)))
    return finding.level, finding.code, sentence


def sentence_of(axes: Sequence[str], message: FindingText) -> str:
    """Return ``[code] axes: sentence``, each axis once."""
    _, code, text = message
    return f"[{code}]{''.join(f' {axis}' for axis in dict.fromkeys(axes))}: {text}"


def print_findings(findings: Sequence[Finding]) -> None:
    """Print findings, errors first; axes with the same sentence share a line.

    Without --verbose, only the first warning or remark of each code is printed, with the number of others.
    """
    if is_set("quiet") or not findings:
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True, highlight=False)
    for message, axes, others in _grave_first(findings):
        text = Text(message[0], style=_STYLES[message[0]])
        tail = ""
        if others:
            where = " ".join(dict.fromkeys(axis for own in others for axis in own))
            tail = f" ({len(others)} more of this kind, on {where}; -v shows all)"
        text.append(printable(f" {sentence_of(axes, message)}{tail}"), style="not bold default")
        console.print(text)


def _grave_first(findings: Sequence[Finding]) -> Iterator[tuple[FindingText, list[str], list[list[str]]]]:
    """Yield findings to print, errors first: text, axes, and the axes of each finding that it replaces."""
    about: dict[FindingText, list[str]] = {}
    for finding in findings:
        message = finding_text(finding)
        about.setdefault(message, []).extend([finding.axis] if finding.axis else [])
    ordered = [(message, axes) for level in _STYLES for message, axes in about.items() if message[0] == level]
    lead: dict[tuple[str, str], FindingText] = {}
    others: dict[FindingText, list[list[str]]] = {}
    for message, axes in ordered:
        first = lead.setdefault(message[:2], message)
        # The first finding of a level and code replaces others about an axis, except errors.
        folds = first is not message and message[0] != "error" and axes and not is_set("verbose")
        others.setdefault(first if folds else message, []).extend([axes] if folds else [])
    yield from ((message, axes, others[message]) for message, axes in ordered if message in others)


def as_typed(path: Path) -> str:
    """Return a path as one argument for a shell: quoted if necessary, and never like an option."""
    text = str(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def name_of_log(log: str) -> str:
    """Return the file name of a log, which may be a path, a URL, or standard input."""
    from imucal.remote.addresses import is_url, name_of, shown

    if log == "-":
        return "stdin"
    return name_of(shown(log)) if is_url(log) else Path(log).resolve().name


def refuse(
    verdict: NoiseVerdict,
    findings: Sequence[Finding],
    *,
    place: object,
    consequence: str,
    printed: bool = False,
    if_moved: Sequence[Fix] = (),
) -> None:
    """Raise a DataError, exit code 4, if data are not noise at rest (unless forced) or --strict forbids them.

    --strict forbids warnings and errors among the `findings`. The message contains the `place` and the
    `consequence`, such as whether a file was written. `printed`: the results were already printed. The
    fixes `if_moved` are for a log that was moved.
    """
    if not verdict.usable and not is_set("force"):
        error = refusal(verdict, findings, place=place, consequence=consequence, if_moved=if_moved)
    elif is_set("strict") and (codes := {f.code: None for f in findings if f.level != "info"}):
        error = DataError(f"{', '.join(codes)} found; --strict allows no warning", place=place)
    else:
        return
    error.printed = printed
    raise error


#: Called with done, total and a word; None without a terminal.
_Update: TypeAlias = Callable[..., None] | None
#: Narrowest terminal with space for the bar, its columns and the time left.
_WIDE = 80
BYTES = ("DownloadColumn", "TransferSpeedColumn")
FITTING = ("fitting {task.fields[word]:8}", "MofNCompleteColumn")


@contextmanager
def progress(text: str, *columns: str, when: bool = True) -> Iterator[_Update]:
    """Yield a function that updates a progress bar with some of rich's columns; None without a terminal."""
    if not when or is_set("quiet") or not sys.stderr.isatty():
        yield None
        return
    from rich import progress as bars
    from rich.console import Console
    from rich.table import Column

    console = Console(stderr=True)
    label = bars.TextColumn(text, table_column=Column(no_wrap=True))
    if console.width < _WIDE:
        shown: list[bars.ProgressColumn] = [label, bars.TaskProgressColumn()]
    else:
        own = [getattr(bars, name)() for name in columns]
        shown = [label, bars.BarColumn(bar_width=20), *own, bars.TimeRemainingColumn()]
    with bars.Progress(*shown, console=console, transient=True) as bar:
        task = bar.add_task("", total=None, word="")
        yield lambda done, total, word="": bar.update(task, completed=done, total=total or None, word=word)


@contextmanager
def fleet_progress(*, when: bool = True) -> Iterator[Callable[["RunCount"], None] | None]:
    """Show the numbers of done, failed and running logs, bytes and time left, on a terminal only."""
    with progress("{task.fields[word]}", "DownloadColumn", when=when) as update:
        yield update and (
            lambda count: update(
                # One more byte per log, so that logs of unknown size count too.
                count.done_size + count.done,
                count.size + count.logs,
                f"{count.done} of {count.logs} logs, {count.failed} failed, {count.running} running",
            )
        )

"""Printing: texts that fit the terminal and never steer it, findings, names, and what ends a command."""

import shlex
import shutil
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import click

from imucal.errors import DataError
from imucal.findings import Finding, Level
from imucal.grading import NoiseVerdict
from imucal.printable import printable, printable_json


def echo(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print text for people, signs that steer a terminal escaped."""
    click.echo(printable(text), err=err, nl=nl)


def echo_json(text: str, *, nl: bool = True) -> None:
    """Print a JSON text on standard output: the same value, such signs as JSON's own escapes."""
    click.echo(printable_json(text), nl=nl)


def picked(value: object, *names: str) -> dict[str, object]:
    """Return some attributes of a value as JSON has them: infinity and not-a-number as null."""
    from imucal.report.json_file import plain

    return {name: plain(getattr(value, name)) for name in names}


def say(text: str | Path, *, quiet: bool = False) -> None:
    """Print a line for people, on standard error, so that standard output holds results only."""
    if not quiet:
        echo(str(text), err=True)


#: Widest table: what fits a terminal, a mail and a log of CI.
FULL = 80
#: Narrower than this nothing is made to fit.
_LEAST = 30


def width() -> int:
    """Return the columns of the terminal, 80 at most; 80 where the output is no terminal."""
    return max(_LEAST, min(FULL, shutil.get_terminal_size((FULL, 24)).columns))


def fitted(line: str, columns: int, *, indent: int) -> list[str]:
    """Return a line, broken between words where it is too long, later lines indented."""
    if len(line) <= columns:
        return [line]
    return textwrap.wrap(line, columns, subsequent_indent=" " * indent, break_on_hyphens=False)


def wrapped(text: str, *, indent: int = 0) -> list[str]:
    """Break a text into lines of the page's width; line breaks of its own are kept."""
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


_STYLES: dict[Level, str] = {"error": "bold red", "warning": "yellow", "info": "cyan"}


@dataclass(slots=True)
class _Line:
    """A sentence, the axes it is said of, and how many more there are of its level and code."""

    level: Level
    code: str
    text: str
    axes: list[str] = field(default_factory=list)
    more: int = 0
    others: list[str] = field(default_factory=list)

    @property
    def tail(self) -> str:
        if not self.more:
            return ""
        where = f", on {' '.join(self.others)}" if self.others else ""
        return f" ({self.more} more like it{where}; -v shows all)"


def print_findings(findings: Sequence[Finding], *, quiet: bool, verbose: bool = False) -> None:
    """Print findings, the grave ones first; axes that share a sentence stand together.

    Of warnings and remarks that differ in their figures alone, one stands for all unless `verbose`.
    """
    if quiet or not findings:
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True, highlight=False)
    for line in _lines(findings, verbose=verbose):
        text = Text(line.level, style=_STYLES[line.level])
        where = f" {' '.join(line.axes)}" if line.axes else ""
        said = printable(f" [{line.code}]{where}: {line.text}{line.tail}")
        text.append(said, style="not bold default")
        console.print(text)


def _lines(findings: Sequence[Finding], *, verbose: bool) -> list[_Line]:
    """Return what to print, grave ones first."""
    same: dict[tuple[str, str, str], _Line] = {}
    for finding in findings:
        plain = finding.text.removeprefix(f"{finding.axis}: ")
        text = " ".join(part for part in (plain, finding.advice, suggestion(finding)) if part)
        line = same.setdefault((finding.level, finding.code, text), _Line(finding.level, finding.code, text))
        line.axes += [finding.axis] if finding.axis and finding.axis not in line.axes else []
    lines = [line for level in _STYLES for line in same.values() if line.level == level]
    return lines if verbose else _folded(lines)


def _folded(lines: Sequence[_Line]) -> list[_Line]:
    """Let the first line of a level and code stand for the others that are about an axis; errors stay."""
    first: dict[tuple[str, str], _Line] = {}
    folded = []
    for line in lines:
        lead = first.setdefault((line.level, line.code), line)
        if lead is line or line.level == "error" or not line.axes:
            folded.append(line)
            continue
        lead.more += 1
        lead.others += [axis for axis in line.axes if axis not in lead.others]
    return folded


def suggestion(finding: Finding) -> str:
    """Return the options that do what the advice of a finding says."""
    if "columns text" in finding.advice:
        return "Say it with --columns."
    if finding.keep_s is None:
        return ""
    start, end = finding.keep_s
    return f"Try --skip {start:.0f}s --take {end - start:.0f}s."


def as_typed(path: Path) -> str:
    """Return a path as a shell takes it for one argument: quoted where it needs to be, never an option."""
    text = str(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def name_of_log(log: str) -> str:
    """Return the own name of a log as it was typed: of a path, a URL, or standard input."""
    from imucal.remote.addresses import is_url, name_of, shown

    if log == "-":
        return "stdin"
    return name_of(shown(log)) if is_url(log) else Path(log).resolve().name


force_option = click.option(
    "--force", is_flag=True, help="Take data that are not noise at rest all the same (else exit code 4)."
)


def refuse(
    verdict: NoiseVerdict, where: str, consequence: str, *, force: bool, forbidden: Sequence[Finding] = ()
) -> None:
    """Raise what ends a command with exit code 4.

    Raises
    ------
    DataError
        Where the data are not noise at rest, unless forced, with `consequence` (what was written or not); or
        where a `forbidden` finding, of a --strict command, is more than a remark.
    """
    if not verdict.usable and not force:
        sentence = verdict.sentence[0].lower() + verdict.sentence[1:]
        msg = f"{where}: {sentence}; {consequence}; record again at rest, or --force"
        raise DataError(msg)
    if codes := dict.fromkeys(finding.code for finding in forbidden if finding.level != "info"):
        msg = f"{where}: {', '.join(codes)} found, and --strict allows no warning"
        raise DataError(msg)

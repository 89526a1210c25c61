"""Findings as people read them, on standard error."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from imucal.findings import Finding, Level
from imucal.printable import printable

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

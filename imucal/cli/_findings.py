"""Findings as people read them, on standard error."""

from imucal.findings import Finding
from imucal.report.result import Report

__all__ = ["all_findings", "print_findings"]

_STYLES = {"error": "bold red", "warning": "yellow", "info": "cyan"}


def all_findings(report: Report) -> tuple[Finding, ...]:
    """Return the findings of the log and of every axis."""
    return report.findings + tuple(finding for axis in report.axes for finding in axis.findings)


def print_findings(report: Report, *, quiet: bool) -> None:
    """Print every finding, the grave ones first; axes that share a sentence stand together."""
    if quiet:
        return
    from rich.console import Console
    from rich.text import Text

    grouped: dict[tuple[int, str, str], list[str]] = {}
    levels = list(_STYLES)
    for finding in all_findings(report):
        text = " ".join(part for part in (finding.text, finding.advice, _suggestion(finding)) if part)
        key = (levels.index(finding.level), finding.code, text)
        grouped.setdefault(key, []).append(finding.axis or "")
    console = Console(stderr=True, highlight=False)
    for (level, code, text), axes in sorted(grouped.items(), key=lambda item: item[0][0]):
        where = " ".join(dict.fromkeys(axis for axis in axes if axis))
        line = Text(levels[level], style=_STYLES[levels[level]])
        line.append(f" [{code}]{' ' + where if where else ''}: {text}", style="not bold default")
        console.print(line)


def _suggestion(finding: Finding) -> str:
    """Return the options that keep the good part of a log."""
    if finding.keep_s is None:
        return ""
    start, end = finding.keep_s
    return f"Try --skip {start:.0f}s --take {end - start:.0f}s."

"""Findings as people read them, on standard error."""

from imucal.findings import Finding
from imucal.report.result import Report

__all__ = ["all_findings", "print_findings"]

_STYLES = {"error": "bold red", "warning": "yellow", "info": "cyan"}


def all_findings(report: Report) -> tuple[Finding, ...]:
    """Return the findings of the log and of every axis."""
    return report.findings + tuple(finding for axis in report.axes for finding in axis.findings)


def print_findings(report: Report, *, quiet: bool, verbose: bool = False) -> None:
    """Print the findings, the grave ones first; axes that share a sentence stand together.

    Of remarks (level info) that differ in their figures alone, one stands for all unless `verbose`.
    """
    if quiet:
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True, highlight=False)
    for level, code, axes, text, others in _grouped(report, verbose=verbose):
        line = Text(level, style=_STYLES[level])
        where = f" {' '.join(axes)}" if axes else ""
        more = f" ({others} more like it; the report has them all)" if others else ""
        line.append(f" [{code}]{where}: {text}{more}", style="not bold default")
        console.print(line)


def _grouped(report: Report, *, verbose: bool) -> list[tuple[str, str, list[str], str, int]]:
    """Return level, code, axes, text and the number of others that it stands for, grave ones first."""
    same: dict[tuple[str, str, str], list[str]] = {}
    for finding in all_findings(report):
        text = " ".join(part for part in (finding.text, finding.advice, _suggestion(finding)) if part)
        axes = same.setdefault((finding.level, finding.code, text), [])
        axes += [finding.axis] if finding.axis and finding.axis not in axes else []
    lines: list[tuple[str, str, list[str], str, int]] = []
    for level in _STYLES:
        group = [(code, axes, text) for (of, code, text), axes in same.items() if of == level]
        if level != "info" or verbose:
            lines += [(level, code, axes, text, 0) for code, axes, text in group]
            continue
        for code in dict.fromkeys(code for code, _, _ in group):
            alike = [(axes, text) for of, axes, text in group if of == code]
            lines.append((level, code, *alike[0], len(alike) - 1))
    return lines


def _suggestion(finding: Finding) -> str:
    """Return the options that keep the good part of a log."""
    if finding.keep_s is None:
        return ""
    start, end = finding.keep_s
    return f"Try --skip {start:.0f}s --take {end - start:.0f}s."

"""REPORT of a command: a report.json, its folder, or a log, which is characterised first."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from imucal.cli._printing import as_typed, name_of_log, say
from imucal.cli.parameters import LogRequest, log_options
from imucal.errors import ReadError
from imucal.remote import is_url
from imucal.remote.addresses import shown
from imucal.report.result import Report

Command = TypeVar("Command", bound=Callable[..., Any])

#: What a REPORT is, for the help of an option that takes no log.
REPORT = "report.json or its folder"


def report_or_log(command: Command) -> Callable[..., Any]:
    """Add the REPORT argument and the options of reading a log; the command gets them as `request`."""
    decorated = log_options(command)
    for parameter in decorated.__click_params__:  # type: ignore[attr-defined]
        if isinstance(parameter, click.Argument):
            parameter.metavar = "REPORT"
            parameter.type = click.Path()  # the shell completes it
        elif parameter.name == "strict":
            parameter.help = "Log: Refuse a damaged log."
        elif parameter.name not in ("quiet", "verbose"):
            parameter.help = f"Log: {parameter.help}"
    return decorated


def load_report(request: LogRequest) -> Report:
    """Load a report, or read and characterise a log.

    Options of reading are refused beside a report: they would change nothing.
    """
    first = next((log for log in request.logs if is_report(log)), None)
    if first is None:
        return _characterise(request)
    if len(request.logs) > 1:
        msg = f"{shown(first)} is a report; give one report, or logs only"
        raise click.UsageError(msg)
    if asked := sorted(request.settings()):
        names = ", ".join(name.removesuffix("_s").removesuffix("_hz").replace("_", "-") for name in asked)
        what = f"{names} is about reading a log; run 'imucal fit' on the log with it"
        msg = f"{shown(first)} is a report, but {what}"
        raise click.UsageError(msg)
    return read_report(first)


def read_report(report: str | Path) -> Report:
    """Load a report by its file, folder or URL; a log is refused, with what to do."""
    from imucal.readers.remote_logs import local_logs
    from imucal.report.json_file import load

    if is_url(report):
        if not is_report(report):
            msg = f"{shown(str(report))}: not a report.json; run 'imucal fit' on it first"
            raise ReadError(msg)
        with local_logs([report]) as reports:
            return load(reports.paths[0])
    path = Path(report)
    if path.is_file() and path.suffix != ".json":
        msg = f"{path}: not a report.json or its folder; run 'imucal fit {as_typed(path)}' first"
        raise ReadError(msg)
    return load(path)


def is_report(log: str | Path) -> bool:
    """Return whether a path or a URL is a report and not a log."""
    if is_url(log):
        return name_of_log(str(log)).endswith(".json")
    path = Path(log)
    return path.suffix == ".json" or (path / "report.json").exists()


def _characterise(request: LogRequest) -> Report:
    from imucal.cli._printing import print_findings
    from imucal.pipeline import Settings

    report = request.characterise(Settings(reading=request.settings()))
    print_findings(report.all_findings, quiet=request.quiet, verbose=request.verbose)
    say("Characterised with the defaults of 'imucal fit'", quiet=request.quiet)
    return report

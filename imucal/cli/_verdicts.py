"""Verdicts for continuous integration: the options of their forms, and the files."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._printing import echo, print_note
from imucal.cli.options import OUTPUT, all_of, flag, option

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucal.checking.ci_files import Case

#: The command gets them as `as_json`, `junit` and `github`.
verdict_options = all_of(
    [
        flag("--json", "as_json", group=OUTPUT, help="Print the verdicts as JSON on standard output."),
        option(
            "--junit",
            group=OUTPUT,
            metavar="FILE",
            type=click.Path(dir_okay=False, path_type=Path),
            help="Also write JUnit XML to FILE.",
        ),
        flag("--github", group=OUTPUT, help="Also print GitHub annotations (on standard error with --json)."),
    ]
)


def write_junit(file: Path, cases: "Sequence[Case]", *, command: str, source: str) -> None:
    """Write JUnit XML of a command about a log or a report, and name the file; raises WriteError."""
    from imucal.atomic import replacing
    from imucal.checking.ci_files import junit_xml

    with replacing(file, ours=command) as scratch:
        scratch.write_text(junit_xml(command, source, cases), encoding="utf-8")
    print_note(file)


def print_annotations(cases: "Sequence[Case]", *, file: str = "", err: bool) -> None:
    """Print the annotations of GitHub; `file` is the file that they belong to."""
    from imucal.checking.ci_files import github_annotations

    for line in github_annotations(cases, file=file):
        echo(line, err=err)

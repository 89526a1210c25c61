"""What the verdict does to a command: the line it says, and the exit code it ends with."""

from collections.abc import Sequence

import click

from imucal.errors import DataError
from imucal.findings import Finding
from imucal.grading import NoiseVerdict

force_option = click.option(
    "--force", is_flag=True, help="Take data that are not noise at rest all the same (else exit code 4)."
)


def refuse(verdict: NoiseVerdict, where: str, consequence: str, *, force: bool) -> None:
    """Raise what ends a command with exit code 4 for data that are not noise at rest, unless forced.

    Raises
    ------
    DataError
        With the verdict's sentence, `consequence` (what was written or not), and what to do.
    """
    if verdict.usable or force:
        return
    sentence = verdict.sentence[0].lower() + verdict.sentence[1:]
    msg = f"{where}: {sentence}; {consequence}; record again at rest, or --force"
    raise DataError(msg)


def refuse_warnings(findings: Sequence[Finding], where: str) -> None:
    """Raise what ends a --strict command with exit code 4 where a finding is more than a remark.

    Raises
    ------
    DataError
        With the codes of the findings.
    """
    codes = dict.fromkeys(finding.code for finding in findings if finding.level != "info")
    if codes:
        msg = f"{where}: {', '.join(codes)} found, and --strict allows no warning"
        raise DataError(msg)

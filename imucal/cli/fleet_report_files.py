"""``imucal fleet report``: what the units of a fleet are like, as JSON, CSV, page and pictures."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._fleet import say_verdict
from imucal.cli._printing import echo, say
from imucal.cli.parameters import SHARE, quiet_option, shown

if TYPE_CHECKING:
    from imucal.findings import Finding


@click.command(
    epilog="""\b
Examples:
  imucal fleet report fleet
  imucal fleet report fleet --content 0.99 --no-html
  imucal export fleet --value tolerance --to kalibr

\b
Exit codes: 0 done, 2 usage, 3 the folder is no fleet or can't be read,
4 no log is done, 5 a file can't be written."""
)
@click.argument("folder", type=click.Path(path_type=Path), metavar="FLEET")
@shown("--content", type=SHARE, default=0.95, help="Share of all units that the tolerance bound holds.")
@shown("--confidence", type=SHARE, default=0.95, help="How sure that is.")
@click.option("--html/--no-html", default=True, help="Write fleet.html.")
@click.option("--pictures/--no-pictures", default=True, help="Write the PNGs.")
@quiet_option
def command(
    *, folder: Path, content: float, confidence: float, html: bool, pictures: bool, quiet: bool
) -> None:
    """Say what the units of each sensor model are like: FLEET is the folder of 'imucal fleet run'.

    Per model, axis and term: the units with their intervals, the median unit, the spreads between units and
    between logs of one unit, where the next unit lies, and the number for the config of every unit (the
    tolerance bound) with what more units would save. Units that are odd or drift are named.
    """
    from imucal.fleet_report import load_fleet, write_fleet

    fleet = load_fleet(folder, content=content, confidence=confidence)
    missing: list[Finding] = []
    for path in write_fleet(fleet, html=html, pictures=pictures, tell=missing.append):
        echo(str(path))
    say_verdict(fleet, missing, quiet=quiet)
    if fleet.loose:
        say(f"to have them counted, run the fleet with --labels '{fleet.labels}'", quiet=quiet)

"""``imucal fleet``: the commands for many logs of many units."""

import click

from imucal.cli import LazyGroup

#: Command -> module that holds it, and the line that --help prints.
FLEET_COMMANDS: dict[str, tuple[str, str]] = {
    "run": ("fleet_running", "Fit one noise model to many logs, on this machine or a cluster."),
    "report": ("fleet_files:report", "Say what the units of each sensor model are like: page, JSON, CSV."),
    "status": ("fleet_files:status", "Say what of a fleet is done, what failed and why, what is left."),
}


@click.group(
    cls=LazyGroup,
    table=FLEET_COMMANDS,
    of_a_log=("characterise a fleet", "run"),
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  imucal fleet run logs --labels '{model}/{unit}/*.mcap' -o fleet
  imucal fleet status fleet
  imucal fleet report fleet""",
)
def command() -> None:
    """Characterise many logs of many units, and the model of the sensor that they are units of.

    `imucal fleet run LOGS…` fits the same noise model to every log and keeps the results in a folder.
    """

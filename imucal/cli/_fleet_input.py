"""A fleet's folder as an argument of commands that take reports."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.remote import is_url

if TYPE_CHECKING:
    from imucal.fleet_report import Fleet

#: Option of commands that take a fleet.
model_option = click.option(
    "--fleet-model", metavar="NAME", help="Fleet: which sensor model, where it has several."
)


def is_fleet(path: str | Path) -> bool:
    """Return whether a path is the folder of a fleet; a URL is none."""
    return not is_url(path) and (Path(path) / "manifest.parquet").is_file()


def read_fleet(path: str | Path) -> "Fleet":
    """Load a fleet, as far as exports, checks and comparisons need it."""
    from imucal.fleet_report import load_fleet

    return load_fleet(path, unit_logs=False)

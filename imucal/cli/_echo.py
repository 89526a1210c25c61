"""Printing: what comes from logs and file names never steers the terminal."""

import click

from imucal.printable import printable, printable_json


def echo(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print text for people, signs that steer a terminal escaped."""
    click.echo(printable(text), err=err, nl=nl)


def echo_json(text: str, *, nl: bool = True) -> None:
    """Print a JSON text on standard output: the same value, such signs as JSON's own escapes."""
    click.echo(printable_json(text), nl=nl)


def say(text: str, *, quiet: bool = False) -> None:
    """Print a line for people, on standard error, so that standard output holds results only."""
    if not quiet:
        echo(text, err=True)

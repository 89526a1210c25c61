"""Options that several commands share."""

import functools

import click

#: An option whose default stands in its help.
shown = functools.partial(click.option, show_default=True)
quiet_option = click.option(
    "-q", "--quiet", is_flag=True, help="Print results only: no progress, findings or paths."
)

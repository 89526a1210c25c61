"""The command line: parse, call, print. One file a command; one line a command in `COMMANDS`."""

import importlib
import sys
from collections.abc import Sequence

import click

from imucal.errors import ImucalError

__all__ = ["COMMANDS", "main"]

#: Command -> module that holds it, and the line that --help prints; a module is imported when called.
COMMANDS: dict[str, tuple[str, str]] = {
    "fit": ("imucal.cli.fit", "Fit a noise model to every axis of a log and write a report."),
    "info": ("imucal.cli.info", "Say what is in a log: topics, rates, duration, units, gaps."),
    "adev": ("imucal.cli.adev", "Print the Allan deviations of every axis as CSV or JSON."),
    "simulate": ("imucal.cli.simulate", "Write a log of known truth (CSV, MCAP, ROS 1 or ROS 2 bag)."),
    "plan": ("imucal.cli.plan", "Say how long to record for a wanted precision."),
    "check": ("imucal.cli.check", "Pass or fail a report or a log against limits (the CI gate)."),
    "compare": ("imucal.cli.compare", "Say which terms of two reports differ significantly."),
    "export": ("imucal.cli.export", "Write the config files of Kalibr, VINS, ORB-SLAM3, PX4 and others."),
    "completion": ("imucal.cli.completion", "Print the shell's completion script (bash, zsh, fish)."),
}


class LazyGroup(click.Group):
    """A group that imports a command when it is called, and turns errors into messages."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(COMMANDS[cmd_name][0])
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in COMMANDS.items()])

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except ImucalError as error:
            click.echo(f"Error: {error}", err=True)
            ctx.exit(error.exit_code)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
def imucal() -> None:
    """Turn a recording of an IMU at rest into a noise model."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; ends the process with its exit code."""
    try:
        imucal.main(args=arguments, prog_name="imucal")
    except KeyboardInterrupt:
        click.echo("Interrupted; nothing is left half written.", err=True)
        sys.exit(130)

"""A group of commands that are imported when they are called."""

import difflib
import importlib
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem


class LazyGroup(click.Group):
    """A group that imports a command when it is called.

    Parameters
    ----------
    table
        Command -> module that holds it, and the line that --help prints.
    of_a_log
        What was meant where a log stands in place of a command, and the command that does it.
    attributes
        As click's groups take them.
    """

    def __init__(
        self,
        *,
        table: Mapping[str, tuple[str, str]],
        of_a_log: tuple[str, str],
        **attributes: Any,  # noqa: ANN401 - as click has them
    ) -> None:
        super().__init__(**attributes)
        self.table, self._of_a_log = table, of_a_log

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        return list(self.table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        if cmd_name not in self.table:
            return None
        module = importlib.import_module(self.table[cmd_name][0])
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Name the command that a mistyped one is near to, or all of them."""
        from imucal.remote.addresses import is_url, shown

        name = args[0]
        if name in self.table or name.startswith("-") or ctx.resilient_parsing:
            return super().resolve_command(ctx, args)
        near = difflib.get_close_matches(name.lower(), self.table, n=1)
        if near:
            hint = f"did you mean {near[0]!r}?"
        elif Path(name).exists():
            purpose, command = self._of_a_log
            hint = f"to {purpose} write '{ctx.command_path} {command} {shlex.quote(name)}'"
        elif is_url(name):
            purpose, command = self._of_a_log
            # What stands behind the question mark of a URL may be a secret.
            name = shown(name)
            hint = f"to {purpose} write '{ctx.command_path} {command} {shlex.quote(name)}'"
        else:
            hint = f"expected one of {', '.join(self.table)}"
        msg = f"No such command {name!r}; {hint}"
        raise click.UsageError(msg, ctx)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Offer commands without importing them, so that the Tab key answers at once."""
        names = [
            CompletionItem(name, help=summary)
            for name, (_, summary) in self.table.items()
            if name.startswith(incomplete)
        ]
        return names + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in self.table.items()])

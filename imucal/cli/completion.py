"""``imucal completion``: the shell's completion script."""

import click
from click.shell_completion import BashComplete, FishComplete, ShellComplete, ZshComplete

from imucal.cli.options import Command, unwrapped

_SHELLS: dict[str, type[ShellComplete]] = {"bash": BashComplete, "zsh": ZshComplete, "fish": FishComplete}


_EPILOG = unwrapped("""
Examples:
  eval "$(imucal completion bash)"                     in ~/.bashrc
  eval "$(imucal completion zsh)"                      in ~/.zshrc
  imucal completion fish > ~/.config/fish/completions/imucal.fish
""")


@click.command(cls=Command, epilog=_EPILOG)
@click.argument("shell", type=click.Choice(list(_SHELLS)))
def command(*, shell: str) -> None:
    """Print the completion script of a shell: bash (4.4 or newer), zsh or fish."""
    root = click.get_current_context().find_root().command
    script = _SHELLS[shell](root, {}, "imucal", "_IMUCAL_COMPLETE")
    # Not BashComplete.source: it runs whichever bash is first in PATH to learn its version.
    click.echo(ShellComplete.source(script))

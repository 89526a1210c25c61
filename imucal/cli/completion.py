"""``imucal completion``: the shell's completion script."""

import click
from click.shell_completion import BashComplete, FishComplete, ShellComplete, ZshComplete

from imucal.cli._declared import argument, declared

_SHELLS: dict[str, type[ShellComplete]] = {"bash": BashComplete, "zsh": ZshComplete, "fish": FishComplete}


@declared
def command(*, shell: str = argument(None, click.Choice(list(_SHELLS)))) -> None:
    """Print the completion script of a shell: bash (4.4 or newer), zsh or fish.

    Examples::
      eval "$(imucal completion bash)"                     in ~/.bashrc
      eval "$(imucal completion zsh)"                      in ~/.zshrc
      imucal completion fish > ~/.config/fish/completions/imucal.fish
    """
    root = click.get_current_context().find_root().command
    script = _SHELLS[shell](root, {}, "imucal", "_IMUCAL_COMPLETE")
    # Not BashComplete.source: it runs whichever bash is first in PATH to learn its version.
    click.echo(ShellComplete.source(script))

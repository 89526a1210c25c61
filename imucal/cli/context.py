"""The running command: flags that its functions ask for, and usage errors."""

from typing import NoReturn

import click

_KEY = "imucal.flag."


def remember(ctx: click.Context, parameter: click.Parameter, value: object) -> object:
    """Keep the value of a flag for `is_set`; a callback of click."""
    ctx.meta[f"{_KEY}{parameter.name}"] = value
    return value


def is_set(name: str) -> bool:
    """Return whether quiet, verbose, force or strict is set; False if no command runs."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(f"{_KEY}{name}"))


def misuse(text: object, *options: str) -> NoReturn:
    """Raise a usage error, exit code 2, for the command or for some `options`."""
    raise click.BadParameter(str(text), param_hint=options) if options else click.UsageError(str(text))

"""Defaults of options from a file: ``imucal.toml``, or the table ``[tool.imucal]`` of ``pyproject.toml``.

A table a command, keys as the options are called: ``method = "gmwm"`` in ``[fit]`` or ``[tool.imucal.fit]``.
What is typed goes before what the file says.
"""

import tomllib
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path

import click

from imucal.errors import SettingError

__all__ = ["defaults_of", "settings_file"]


def settings_file() -> tuple[Path, dict[str, object]] | None:
    """Return the file of this folder that has defaults, and its tables; None where there is none.

    Raises
    ------
    SettingError
        If it can't be read.
    """
    for name, keys in (("imucal.toml", ()), ("pyproject.toml", ("tool", "imucal"))):
        path = Path(name)
        if not path.is_file():
            continue
        try:
            found: object = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            msg = f"{path}: can't be read as TOML ({error}); correct it"
            raise SettingError(msg) from error
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        if isinstance(found, dict):
            return path, found
    return None


def defaults_of(command: click.Command, table: object, where: str) -> dict[str, object]:
    """Return what a table says of a command, by the names of its parameters.

    Raises
    ------
    SettingError
        If it is no table, or names what is no option of the command; the message suggests the nearest.
    """
    if not isinstance(table, Mapping):
        msg = f"{where} is {table!r}, expected a table of options"
        raise SettingError(msg)
    options = {
        name.lstrip("-"): parameter
        for parameter in command.params
        if isinstance(parameter, click.Option)
        for name in parameter.opts
        if name.startswith("--")
    }
    found: dict[str, object] = {}
    for key, value in table.items():
        if key not in options:
            near = get_close_matches(key, options, n=1)
            hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(sorted(options))}"
            msg = f"{where}: there is no option {key!r}; {hint}"
            raise SettingError(msg)
        found[str(options[key].name)] = value if isinstance(value, bool | list) else str(value)
    return found

"""Names that messages use: a path as a shell takes it, and what a typed log is called."""

import shlex
from pathlib import Path


def as_typed(path: Path) -> str:
    """Return a path as a shell takes it for one argument: quoted where it needs to be, never an option."""
    text = str(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def name_of_log(log: str) -> str:
    """Return the own name of a log as it was typed: of a path, a URL, or standard input."""
    from imucal.remote.addresses import is_url, name_of, shown

    if log == "-":
        return "stdin"
    return name_of(shown(log)) if is_url(log) else Path(log).resolve().name

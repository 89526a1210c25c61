"""Target: one downstream format."""

from collections.abc import Callable
from dataclasses import dataclass

from imucal.report.exports.config_numbers import Numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A downstream format.

    Attributes
    ----------
    name
        What the user asks for.
    title
        The consumer and its file, for a list.
    file_name
        Name of the file where the user gives a folder.
    render
        Numbers -> text of the file; raises `DataError` where a number is missing.
    aliases
        Other names it goes by.
    """

    name: str
    title: str
    file_name: str
    render: Callable[[Numbers], str]
    aliases: tuple[str, ...] = ()

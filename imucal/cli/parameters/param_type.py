"""click's `ParamType`, with the type that it converts to in brackets, whatever the version of click.

From click 8.4 on `ParamType` is generic, and type checkers ask for the brackets; before, it has none.
"""

from typing import TYPE_CHECKING

import click

__all__ = ["ParamType"]

if TYPE_CHECKING:
    from click import ParamType
else:

    class ParamType(click.ParamType):
        """A parameter type; the brackets are for type checkers."""

        def __class_getitem__(cls, _: object) -> type:
            return cls

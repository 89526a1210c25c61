"""Values that a notebook shows: a few lines of text, the page's own table, a data frame.

What draws them stands above every value, so that it is loaded by its name, when a person looks.
"""

from importlib import import_module
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    import polars as pl


class Displayed:
    """A value that says in at most twelve lines what it holds."""

    __slots__ = ()
    #: Module with `text_of`, `html_of` and `frame_of`, which take the value.
    drawn_by: ClassVar[str] = "imucal.report.notebook"

    def __repr__(self) -> str:
        return str(import_module(self.drawn_by).text_of(self))

    def _repr_html_(self) -> str:
        return str(import_module(self.drawn_by).html_of(self))

    def to_frame(self) -> "pl.DataFrame":
        """Return it as a polars data frame; ``.to_pandas()`` makes it one of pandas, where that is there."""
        frame: pl.DataFrame = import_module(self.drawn_by).frame_of(self)
        return frame

"""Values that a notebook shows: a few lines of text, the page's table, a data frame.

The module that draws them imports the modules of all values, so it is loaded only when it is needed.
"""

from importlib import import_module
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    import polars as pl


class Displayed:
    """A value with a text of at most twelve lines, a table and a data frame."""

    #: Module with `text_of`, `html_of` and `frame_of`, which take the value.
    drawn_by: ClassVar[str] = "imucal.report.notebook"

    def __repr__(self) -> str:
        return str(import_module(self.drawn_by).text_of(self))

    def _repr_html_(self) -> str:
        return str(import_module(self.drawn_by).html_of(self))

    def to_frame(self) -> "pl.DataFrame":
        """Return a polars data frame; ``.to_pandas()`` converts it if pandas is installed."""
        frame: pl.DataFrame = import_module(self.drawn_by).frame_of(self)
        return frame

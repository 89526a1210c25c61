"""Colours and line styles, one set for pictures and page.

Darkened from Okabe & Ito (2008), "Color universal design", so that they also serve as text on
white (contrast above 4.5); every colour comes with its own line style or marker as well.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Stroke:
    """How a line is drawn: its colour on white, its colour on black, its dashes in points."""

    light: str
    dark: str
    dashes: tuple[float, ...]


INK = "#1c2733"
DATA = Stroke("#33414f", "#c9d4df", ())
MODEL = Stroke("#0063a3", "#5db6f2", ())
#: Text of second rank.
FADED = "#66717d"
#: What the fit did not use.
UNUSED = "#b4bcc5"
#: Spectral lines.
LEFT_OUT = "#b00020"
GRID = "#e3e7ec"
#: Spines and ticks.
FRAME = "#9aa5b1"

#: Symbol of a term -> its stroke.
TERMS: dict[str, Stroke] = {
    "Q": Stroke("#8a6100", "#e6b64c", (1, 2)),
    "N": Stroke("#b84300", "#ff9157", (6, 2)),
    "B": Stroke("#00734f", "#36c99a", (6, 2, 1, 2)),
    "GM": Stroke("#5c4a9e", "#a99cf0", (3, 1.5)),
    "K": Stroke("#a63c78", "#ee8fc4", (10, 3)),
    "R": Stroke("#4c6a00", "#a9cc45", (8, 2, 1, 2, 1, 2)),
}

#: Axis -> its stroke in an overview.
AXES: dict[str, Stroke] = {
    "x": Stroke("#b84300", "#ff9157", ()),
    "y": Stroke("#0063a3", "#5db6f2", (6, 2)),
    "z": Stroke("#00734f", "#36c99a", (2, 1.5)),
}

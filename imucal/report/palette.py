"""Colours and line styles, one set for pictures and page; those of a term stand in its class.

Darkened from Okabe & Ito (2008), "Color universal design", so that they also serve as text on
white (contrast above 4.5); every colour comes with its own line style or marker as well.
"""

from imucal.noise.term import Stroke

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

#: Axis -> its stroke in an overview.
AXES: dict[str, Stroke] = {
    "x": Stroke("#b84300", "#ff9157", ()),
    "y": Stroke("#0063a3", "#5db6f2", (6, 2)),
    "z": Stroke("#00734f", "#36c99a", (2, 1.5)),
}

"""Samples -> AllanCurve: what the data shows."""

from imucal.allan.cascade import Cascade
from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Spectrum, spectrum
from imucal.allan.engine import allan_curve

__all__ = ["AllanCurve", "Cascade", "Spectrum", "allan_curve", "spectrum"]

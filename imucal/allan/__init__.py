"""Samples -> AllanCurve: what the data shows."""

from imucal.allan.cascade import Cascade
from imucal.allan.curve import AllanCurve
from imucal.allan.engine import allan_curve
from imucal.allan.spectrum import Spectrum, spectrum

__all__ = ["AllanCurve", "Cascade", "Spectrum", "allan_curve", "spectrum"]

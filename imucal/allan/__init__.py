"""Samples -> AllanCurve: Allan variances and spectrum of one axis."""

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Spectrum, spectrum
from imucal.allan.engine import allan_curve

__all__ = ["AllanCurve", "Spectrum", "allan_curve", "spectrum"]

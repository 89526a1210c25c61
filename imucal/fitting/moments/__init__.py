"""Fits of the Allan curve: GMWM and the classical reading of slopes."""

from imucal.fitting.moments.gmwm import fit_gmwm
from imucal.fitting.moments.slope import fit_slope

__all__ = ["fit_gmwm", "fit_slope"]

"""Fits of the Allan curve: GMWM and the classical reading of slopes."""

from imucal.fitting.moments.gmwm import fit_gmwm
from imucal.fitting.moments.points import avar_covariance
from imucal.fitting.moments.slope import fit_slope

__all__ = ["avar_covariance", "fit_gmwm", "fit_slope"]

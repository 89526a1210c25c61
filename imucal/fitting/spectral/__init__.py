"""Maximum likelihood on the spectrum of the samples, and how well a record can tell a model."""

from imucal.fitting.spectral.mle import fit_mle, spectral_view
from imucal.fitting.spectral.precision import relative_deviations

__all__ = ["fit_mle", "relative_deviations", "spectral_view"]

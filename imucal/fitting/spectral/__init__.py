"""Maximum likelihood on the spectrum of the samples, and the precision that a record allows."""

from imucal.fitting.spectral.mle import fit_mle, spectral_view
from imucal.fitting.spectral.precision import named_terms, relative_deviations

__all__ = ["fit_mle", "named_terms", "relative_deviations", "spectral_view"]

"""Which Gauss-Markov term of a model an estimate speaks of."""

import math

from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.noise.terms import GaussMarkov


def gauss_markov_term(fit: NoiseFit, estimate: Estimate) -> GaussMarkov | None:
    """Return the term whose correlation time is the estimate's; None where the model has none."""
    terms = [term for term in fit.model.terms if isinstance(term, GaussMarkov)]
    time = estimate.correlation_time
    if estimate.value is None or time is None or not terms:
        return None
    return min(terms, key=lambda term: abs(math.log(term.T / time.value)))

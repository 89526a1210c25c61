"""The maximum compared with that of the exact state-space likelihood."""

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.state_space import fit_exact
from imucal.noise.model import NoiseModel
from imucal.noise.terms import term_keys
from imucal.recording import AxisSeries

#: Distance of the two maxima, in standard errors, that is reported as a warning.
_FAR = 0.5


def verify_findings(
    series: AxisSeries, model: NoiseModel, names: tuple[str, ...], covariance: FloatArray
) -> tuple[Finding, ...]:
    """Return how far the exact likelihood's maximum is from `model`, in standard errors.

    Slow: some seconds for 1e5 samples. `names` and `covariance`, shape (p, p), are the fit's own.
    """
    distance = distances(series, model, names, covariance)
    worst = max(distance, key=lambda name: distance[name], default="")
    if not worst:
        return ()
    far = distance[worst] > _FAR
    return (
        Finding(
            level="warning" if far else "info",
            code="verified",
            axis=series.name,
            text="The exact state-space likelihood has its maximum "
            f"{distance[worst]:.2g} standard errors away at most ({worst}).",
            advice="Trust neither alone: look for lines, a filter or a misfit." if far else "",
        ),
    )


def distances(
    series: AxisSeries, model: NoiseModel, names: tuple[str, ...], covariance: FloatArray
) -> dict[str, float]:
    """Return how far each parameter is from the exact likelihood's maximum, in standard errors."""
    structure = tuple(term.symbol for term in model.terms)
    exact, _ = fit_exact(series, structure, model)
    here, there = _values(model), _values(exact)
    deviation = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return {
        name: abs(there[name] - here[name]) / deviation[name]
        for name in here
        if np.isfinite(deviation[name]) and deviation[name] > 0
    }


def _values(model: NoiseModel) -> dict[str, float]:
    """Return the model's parameters under the names that a fit's covariance uses."""
    keys = term_keys(term.symbol for term in model.terms)
    return {
        name: abs(value)
        for term, key in zip(model.terms, keys, strict=True)
        for name, value in zip(term.parameter_names(key), term.values, strict=True)
    }

"""From the samples of an axis to its Allan curve."""

from collections.abc import Sequence

import numpy as np

from imucal.allan.averaging import averaging_factors
from imucal.allan.curve import AllanCurve
from imucal.allan.estimators import estimator_named
from imucal.allan.variance import variances
from imucal.errors import DataError
from imucal.recording import AxisSeries

__all__ = ["allan_curve"]


def allan_curve(
    series: AxisSeries,
    *,
    taus: str | Sequence[float] = "octave",
    estimator: str = "overlapping",
    edf: str = "hybrid",
) -> AllanCurve:
    """Return the Allan curve of an axis, with the degrees of freedom of each value."""
    table = estimator_named(estimator)
    series = series.finite()
    n = series.n
    if table.largest(n) < 1:
        msg = f"{series.name}: {n} samples are too few for an Allan variance; at least 2 are needed"
        raise DataError(msg)
    m = averaging_factors(
        taus, tau0=series.tau0, largest=table.largest(n), drawn=table.drawn(n), name=series.name
    )
    avar = variances(series.samples, m, table)
    terms = np.array([table.terms(n, mi) for mi in m.tolist()])
    return AllanCurve(
        tau=m.astype(np.float64) * series.tau0,
        m=m,
        avar=avar,
        edf=np.maximum(terms / (2.0 * m), 1.0),
        n=n,
        estimator=estimator,
        edf_method=edf,
    )

"""From the samples of an axis to its Allan curve."""

from collections.abc import Sequence

import numpy as np

from imucal.allan.averaging import averaging_factors
from imucal.allan.confidence import degrees_of_freedom
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
    """Return the Allan curve of an axis, with the degrees of freedom of each value.

    Parameters
    ----------
    series
        The axis; samples that are not finite count as missing.
    taus
        ``octave``, ``decade``, ``decade:20``, ``all``, or averaging times in s. The named sets but
        ``all`` stop where a value has some 2 degrees of freedom: m <= n/4, n/6 for third differences.
    estimator
        ``overlapping`` (the Allan variance, MOAV), ``standard``, ``modified`` or ``hadamard``.
    edf
        ``hybrid``, ``model``, ``greenhall`` or ``eta3``; see `imucal.allan.confidence`.

    Raises
    ------
    DataError
        If there are too few samples, or a listed averaging time is out of their reach.
    ValueError
        If an option is not one of these.

    Source: IEEE Std 952-1997, Annex C; NIST SP 1065 (2008).
    """
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
    return AllanCurve(
        tau=m.astype(np.float64) * series.tau0,
        m=m,
        avar=avar,
        edf=degrees_of_freedom(series.samples, m, table, edf),
        n=n,
        estimator=estimator,
        edf_method=edf,
    )

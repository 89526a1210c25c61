"""AllanCurve: the Allan variances of one axis with their degrees of freedom."""

from dataclasses import dataclass

import numpy as np
import scipy

from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays
from imucal.display import Displayed
from imucal.errors import ArgumentError


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AllanCurve(Displayed, ReadOnlyArrays):
    """Allan variances at increasing averaging times.

    Attributes
    ----------
    tau
        Averaging times m * tau0, shape (k,), in s, increasing.
    m
        Averaging factors, shape (k,).
    avar
        Allan variances, shape (k,), in the square of the sample unit.
    edf
        Equivalent degrees of freedom of each value, shape (k,); NaN if unknown.
    n
        Number of samples; 0 if unknown (a curve from another tool).
    estimator
        ``overlapping`` (MOAV), or ``standard`` (non-overlapping) for a curve from another tool.
    computed
        Method: ``exact``, ``windows`` or ``runs`` (gaps), ``given``
        (a curve from another tool).
    edf_method
        Source of `edf`: ``hybrid`` (the spectrum at short times, a noise model at long ones), ``model`` (a
        noise model at every time); empty if unknown.
    """

    tau: FloatArray
    m: IntArray
    avar: FloatArray
    edf: FloatArray
    n: int
    estimator: str = "overlapping"
    computed: str = "exact"
    edf_method: str = ""

    def __post_init__(self) -> None:
        ReadOnlyArrays.__post_init__(self)
        shapes = {self.tau.shape, self.m.shape, self.avar.shape, self.edf.shape}
        if len(shapes) != 1 or self.tau.ndim != 1:
            raise ArgumentError(f"tau, m, avar and edf must share one shape (k,), got {sorted(shapes)}")
        if not np.all(np.diff(self.tau) > 0):
            raise ArgumentError("tau must increase")

    @property
    def adev(self) -> FloatArray:
        """Allan deviations, shape (k,), in the sample unit."""
        return np.sqrt(self.avar)

    def confidence_interval(self, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Return the lower and upper limits of the Allan *deviation*, each of shape (k,).

        ``edf * avar / true avar`` is assumed to be chi-squared with `edf` degrees of freedom, so both
        limits are positive. NaN if the degrees of freedom are unknown.

        Raises
        ------
        ValueError
            If `level` is not between 0 and 1.

        Source: NIST SP 1065 (2008), sec. 5.3.1.
        """
        if not 0 < level < 1:
            raise ArgumentError(f"level must be between 0 and 1, got {level}")
        tail = (1 - level) / 2
        low = self.edf * self.avar / scipy.special.chdtri(self.edf, tail)
        high = self.edf * self.avar / scipy.special.chdtri(self.edf, 1 - tail)
        return np.sqrt(low), np.sqrt(high)

    @property
    def minimum(self) -> tuple[float, float]:
        """The lowest Allan deviation and its tau, in the sample unit and s.

        Many tools call it "bias instability", but it is not B: see `imucal.noise.terms`. Values with fewer
        than 2 degrees of freedom are ignored if there are others.
        """
        sure = np.flatnonzero(~(self.edf < 2))
        index = sure if sure.size else np.arange(self.tau.size)
        best = index[np.argmin(self.avar[index])]
        return float(np.sqrt(self.avar[best])), float(self.tau[best])

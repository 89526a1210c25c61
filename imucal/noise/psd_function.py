"""A psd as a function of frequency that checks what it returns."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray

#: A psd of frequencies in Hz, shape (k,); or frequencies that rise, and the psd there.
Psd: TypeAlias = Callable[[FloatArray], ArrayLike] | tuple[ArrayLike, ArrayLike]


def psd_function(psd: Psd) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
    """Return the psd as a checked function, and where it has corners."""
    if callable(psd):
        function, corners = psd, np.zeros(0)
    else:
        function, corners = _function_of_points(*psd)

    def checked(f: FloatArray) -> FloatArray:
        with np.errstate(over="ignore", divide="ignore"):
            values = np.asarray(function(f.ravel()), dtype=np.float64)
        if values.shape != (f.size,):
            msg = f"psd must return shape ({f.size},) for frequencies of that shape, got {values.shape}"
            raise ValueError(msg)
        wrong = np.flatnonzero(~(values >= 0))
        if wrong.size:
            at = wrong[0]
            msg = f"psd must be 0 or more everywhere, got {values[at]:g} at {f.ravel()[at]:.6g} Hz"
            raise ValueError(msg)
        return values.reshape(f.shape)

    return checked, corners


def _function_of_points(
    frequency: ArrayLike, density: ArrayLike
) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
    """Return the function that runs straight on logarithmic axes between points, and the points."""
    f, s = np.asarray(frequency, dtype=np.float64), np.asarray(density, dtype=np.float64)
    if f.ndim != 1 or f.shape != s.shape or not f.size:
        msg = f"a psd of arrays must be two of one shape (k,), got {f.shape} and {s.shape}"
        raise ValueError(msg)
    if not (f[0] > 0 and np.all(np.diff(f) > 0) and np.all(np.isfinite(f))):
        msg = "frequencies of a psd must rise, and be positive and finite"
        raise ValueError(msg)
    if not (np.all(s > 0) and np.all(np.isfinite(s))):
        at = int(np.argmin((s > 0) & np.isfinite(s)))
        msg = f"psd given by points must be positive and finite, got {s[at]:g} at {f[at]:.6g} Hz"
        raise ValueError(msg)
    x, y = np.log(f), np.log(s)
    return (lambda at: np.exp(np.interp(np.log(at), x, y))), f

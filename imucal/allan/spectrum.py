"""The log-binned power spectral density, the picture beside the Allan curve."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, read_only

__all__ = ["Spectrum"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spectrum:
    """A two-sided power spectral density, averaged over bins of rising width.

    Attributes
    ----------
    frequency
        Mean frequency of each bin, shape (k,), in Hz, rising.
    psd
        Two-sided density, shape (k,), in U²/Hz.
    count
        Degrees of freedom of each bin, shape (k,): the ordinates it averages.
    """

    frequency: FloatArray
    psd: FloatArray
    count: FloatArray

    def __post_init__(self) -> None:
        for name in ("frequency", "psd", "count"):
            array = read_only(np.asarray(getattr(self, name), dtype=np.float64))
            object.__setattr__(self, name, array)

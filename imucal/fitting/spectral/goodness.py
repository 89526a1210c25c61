"""Whether a fitted spectrum describes the ordinates it was fitted to."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.spectral.likelihood import Candidates, evaluate
from imucal.fitting.spectral.ordinates import Ordinates

#: Neighbouring bins are joined until they hold so many degrees of freedom.
_JOIN = 8.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Misfit:
    """A standard-normal score of the misfit, its p-value, and the mean squared residual."""

    statistic: float
    p_value: float
    chi2_per_bin: float


def misfit(ordinates: Ordinates, candidate: Candidates, theta: FloatArray) -> Misfit:
    """Return how far one candidate at `theta`, shape (1, p), is from the ordinates.

    Each group's sum of X²/S is chi-squared with its n degrees of freedom: mean n, variance 2n, and
    the squared standardised residual has mean 1 and variance 2 + 12/n.
    """
    from scipy.special import ndtr

    found = evaluate(ordinates, candidate, theta)
    power = ordinates.power.copy()
    beta = found.beta[0]
    power += -2 * beta @ ordinates.cross + np.einsum("i,ijb,j->b", beta, ordinates.gram, beta)
    ratio = power / found.spectrum[0]
    group = np.floor((np.cumsum(ordinates.size) - ordinates.size / 2) / _JOIN)
    first = np.flatnonzero(np.diff(group, prepend=-1.0) != 0)
    size = np.add.reduceat(ordinates.size, first)
    residual = (np.add.reduceat(ratio, first) - size) / np.sqrt(2 * size)
    square = float(np.mean(residual**2))
    statistic = (square - 1) * size.size / float(np.sqrt(np.sum(2 + 12 / size)))
    return Misfit(statistic=statistic, p_value=float(ndtr(-statistic)), chi2_per_bin=square)

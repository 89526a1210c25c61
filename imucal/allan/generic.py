"""The generic model: the four power laws (and a drift) that best describe a spectrum.

It need not be true: the intervals of a curve only need the local shape of the spectrum.
"""

import numpy as np

from imucal.allan.covariance import GenericModel
from imucal.allan.dct import DctBins, ramp_ordinates
from imucal.arrays import BoolArray, FloatArray
from imucal.powerlaw import PowerLaw

#: A drift has zero mean beyond this ordinate, to 1e-6 of its squares.
_DRIFT_ORDINATES = 128

#: Twice the log likelihood that a drift must gain: the 95 % quantile of chi-squared with 1 dof.
_DRIFT_GAIN = 3.84

_ROUNDS = 30
#: Added to the diagonal of the laws' correlation, so that laws that are alike are not singular.
_RIDGE = 1e-12


def fit_spectrum(ordinates: FloatArray, power: FloatArray, bins: DctBins) -> GenericModel:
    """Return the maximum-likelihood generic model of DCT-II ordinates.

    Parameters
    ----------
    ordinates
        The lowest ordinates from k = 1 on, shape (j,); they show the drift.
    power
        Sums of squared ordinates, shape (b,).
    bins
        Their bins.

    Notes
    -----
    The model is scored bin by bin as -log L = ½ Σ (n_b log S_b + P_b / S_b). The drift is kept
    only where it gains 3.84 in 2 log L.

    Source: Whittle (1953), with the exact E[X_k²] of the DCT-II in place of the psd.
    """
    count = bins.count.astype(np.float64)
    basis = np.array([law.dct_spectrum(bins.n, bins.first, bins.count) for law in PowerLaw])
    plain, plain_score = _fit(basis, power, count)
    singles = min(_DRIFT_ORDINATES, ordinates.size, int(np.argmin(bins.count == 1)) or bins.size)
    shape = ramp_ordinates(bins.n, singles)
    low = ordinates[:singles]
    variances, score, drift = plain, plain_score, 0.0
    for _ in range(3):
        spectrum = variances @ basis[:, :singles]
        if not spectrum.all():
            return GenericModel(variances=tuple(plain.tolist()))
        drift = float(np.sum(low * shape / spectrum) / np.sum(shape**2 / spectrum))
        rest = power.copy()
        rest[:singles] = (low - drift * shape) ** 2
        variances, score = _fit(basis, rest, count, start=plain)
    if 2 * (plain_score - score) > _DRIFT_GAIN:
        return GenericModel(variances=tuple(variances.tolist()), drift=drift)
    return GenericModel(variances=tuple(plain.tolist()))


def fit_curve(m: FloatArray, avar: FloatArray, weight: FloatArray) -> GenericModel:
    """Return the generic model nearest to a curve, where there is no spectrum to fit.

    Parameters
    ----------
    m, avar
        The curve, shape (k,).
    weight
        Rough degrees of freedom of each value, shape (k,).
    """
    good = avar > 0
    basis = np.array([law.avar(m[good]) for law in PowerLaw])
    variances = _non_negative(basis / avar[good], np.ones(int(good.sum())), weight[good])
    return GenericModel(variances=tuple(variances.tolist()))


def _fit(
    basis: FloatArray, power: FloatArray, count: FloatArray, start: FloatArray | None = None
) -> tuple[FloatArray, float]:
    """Minimise the score over non-negative variances by iterated weighted least squares.

    The weights are those of Fisher scoring; a step is halved until the score falls.
    """
    level = power / count
    floor = float(level.sum()) * 1e-30
    if not floor:
        return np.zeros(len(basis)), 0.0
    variances = _start(basis, level, count) if start is None else start
    score = _score(variances @ basis, power, count, floor)
    for _ in range(_ROUNDS):
        spectrum = variances @ basis + floor
        target = _non_negative(basis / spectrum, level / spectrum, count)
        step = 1.0
        while step > 1e-3:
            trial = variances + step * (target - variances)
            trial_score = _score(trial @ basis, power, count, floor)
            if trial_score < score:
                break
            step /= 2
        else:
            break
        gain, variances, score = score - trial_score, trial, trial_score
        if gain < 1e-3:
            break
    return variances, score


def _start(basis: FloatArray, level: FloatArray, count: FloatArray) -> FloatArray:
    """Return a start by multiplicative updates, which keep variances positive and never diverge."""
    variances = np.array([np.quantile(level / law, 0.25) for law in basis]) / len(basis)
    variances += np.array([float((level * count).sum() / (law * count).sum()) for law in basis]) * 1e-6
    for _ in range(20):
        spectrum = variances @ basis
        variances = variances * np.sqrt(
            (basis @ (count * level / spectrum**2)) / (basis @ (count / spectrum))
        )
    return variances


def _score(spectrum: FloatArray, power: FloatArray, count: FloatArray, floor: float) -> float:
    safe = spectrum + floor
    return 0.5 * float(count @ np.log(safe) + np.sum(power / safe))


def _non_negative(basis: FloatArray, target: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the weights v >= 0 that minimise Σ weight (target - v @ basis)², shape (4,).

    Source: Lawson & Hanson (1974), Solving Least Squares Problems, ch. 23.
    """
    scale = np.sqrt(np.maximum((basis**2) @ weight, np.finfo(np.float64).tiny))
    unit = basis / scale[:, None]
    gram, moment = (unit * weight) @ unit.T, (unit * weight) @ target
    gram += _RIDGE * np.eye(len(basis))
    values = np.zeros(len(basis))
    free = np.zeros(len(basis), dtype=bool)
    for _ in range(3 * len(basis)):
        slope = np.where(free, -np.inf, moment - gram @ values)
        if slope.max() <= 1e-10 * np.abs(moment).max():
            break
        free[int(np.argmax(slope))] = True
        values = _inside(gram, moment, values, free)
        free = values > 0
    return values / scale


def _inside(gram: FloatArray, moment: FloatArray, values: FloatArray, free: BoolArray) -> FloatArray:
    """Walk from `values` towards the free minimum, dropping each weight that reaches zero."""
    free = free.copy()
    while True:
        chosen = np.flatnonzero(free)
        wanted = np.zeros(values.size)
        wanted[chosen] = np.linalg.solve(gram[np.ix_(chosen, chosen)], moment[chosen])
        low = chosen[wanted[chosen] <= 0]
        if not low.size:
            return wanted
        step = np.min(values[low] / (values[low] - wanted[low]))
        values = values + step * (wanted - values)
        values[low[values[low] <= 1e-15]] = 0.0
        free &= values > 0
        if not free.any():
            return np.zeros(values.size)

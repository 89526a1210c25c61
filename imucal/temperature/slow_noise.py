"""The noise of block means: white, flicker and random walk, by restricted maximum likelihood.

Restricted likelihood sees only what regressors leave, so that the noise is not underestimated when a curve
with many coefficients is fitted. Flicker noise and random walk have no covariance, but the variance of
differences, D, which is enough for the contrasts of a fit with a constant: -D/2 takes the place of the
covariance.

Source: Patterson & Thompson (1971), Biometrika 58, "Recovery of inter-block information"; Cressie (1993),
"Statistics for Spatial Data", section 5.4 (intrinsic covariance).
"""

from dataclasses import dataclass

import numpy as np
import scipy

from imucal.arrays import FloatArray
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS
from imucal.temperature.ramp import AxisBlocks

#: The terms of the slow noise, in the order of its variances.
_SLOW = ("B", "K")
#: Limits of the logarithm of a variance, relative to the variance of what the regressors leave.
_BOUNDS = (-30.0, 6.0)
#: Starting values: shares of that variance. Slow terms start small, so that the curve is not taken for them.
_START = (0.5, 0.1, 0.01)
#: Parts of a block whose mean stands for it: a walk between means is then exact to 1 %.
_PARTS = 8
#: A smaller share of the mean square than this is rounding of floats.
_NOTHING = 1e-24
#: Multiple of the largest covariance that is added as the variance of the constant.
_FREE = 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockNoise:
    """Covariances of unit noise in m blocks: `parts`, shape (3, m, m), of white, flicker and walk noise."""

    parts: FloatArray

    @classmethod
    def of(cls, axis: AxisBlocks, block_s: float) -> "BlockNoise":
        lags = np.abs(axis.places[:, None] - axis.places[None, :])
        parts = [np.diag(axis.counts.mean() / axis.counts)]
        for symbol in _SLOW:
            structure = _of_means(TERMS[symbol].of(1.0), int(lags.max()), block_s)
            parts.append(-0.5 * structure[lags] / structure.max())
        return cls(parts=np.array(parts))

    def variances(self, samples: FloatArray, regressors: FloatArray) -> FloatArray:
        """Return the variances of the three terms, shape (3,), that are the most likely ones.

        `regressors`, shape (m, r), contain the constant.
        """
        contrasts = scipy.linalg.qr(regressors)[0][:, regressors.shape[1] :]
        rest = contrasts.T @ samples
        scale = float(np.mean(rest**2))
        if not scale > _NOTHING * float(np.mean(samples**2)):
            return np.zeros(3)
        parts = np.array([contrasts.T @ part @ contrasts for part in self.parts])
        # In units in which each term alone explains the mean square of the rest.
        sizes = np.einsum("ijj->i", parts) / rest.size
        parts /= sizes[:, None, None]
        flat = parts.reshape(len(parts), -1)
        rest = rest / np.sqrt(scale)

        def cost(logs: FloatArray) -> tuple[float, FloatArray]:
            variances = np.exp(logs)
            covariance = np.tensordot(variances, parts, axes=1)
            try:
                factor = scipy.linalg.cho_factor(covariance, lower=True)
            except np.linalg.LinAlgError:
                return np.inf, np.zeros(3)
            inverse = scipy.linalg.cho_solve(factor, np.eye(rest.size))
            white = inverse @ rest
            value = float(np.log(np.diag(factor[0])).sum() + 0.5 * rest @ white)
            traces = flat @ inverse.ravel()
            quadratic = parts @ white @ white
            return value, 0.5 * variances * (traces - quadratic)

        found = scipy.optimize.minimize(
            cost, np.log(_START), jac=True, method="L-BFGS-B", bounds=[_BOUNDS] * 3
        )
        return np.asarray(np.exp(found.x) * scale / sizes)

    def covariance(self, variances: FloatArray) -> FloatArray:
        """Return the covariance of the blocks, shape (m, m), whose constant is unknown."""
        total = np.tensordot(variances, self.parts, axes=1)
        # A unit structure is at most 1, so the sum of variances bounds all elements.
        return np.asarray(total + _FREE * float(variances.sum()))


def _of_means(term: NoiseTerm, longest: int, block_s: float) -> FloatArray:
    """Return the mean square difference of block means 0 … `longest` blocks apart, shape (longest + 1,).

    It is the mean of D over all pairs of parts of both blocks, less that within a block.
    """
    parts = np.arange(1.0, (longest + 1) * _PARTS + 1)
    structure = np.concatenate([[0.0], term.structure(parts, block_s / _PARTS)])
    offsets = np.arange(1 - _PARTS, _PARTS)
    weights = (_PARTS - np.abs(offsets)) / _PARTS**2
    places = np.abs(_PARTS * np.arange(longest + 1)[:, np.newaxis] + offsets)
    means = structure[places] @ weights
    return np.asarray(means - means[0])

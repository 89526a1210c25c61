"""Records of which most samples are missing: their completion takes the noise of single samples for white.

If slow noise is strong beside it, or if the model does not give the variance of the differences of
neighbours, N is wrong by up to as much. The intervals then widen by this share.
"""

from collections.abc import Sequence

import numpy as np

from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate
from imucal.fitting.spectral.disturbances.gaps import WHITE_FROM
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.models import COLUMN
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries

__all__ = ["sparse_factor", "sparse_finding", "wrong_share"]

#: Share by which N may be wrong beside any slow noise: with K = 0.01 N per sample it is 1 % too small, with
#: K = 0.03 N it is 4 %.
_WITH_SLOW = 0.05
#: Narrowest half of an interval of N, relative to N: no record is so long.
_NARROWEST = 1e-4
#: Terms that are not slow.
_FAST = frozenset({"Q", "N"})
#: Standard errors of the variance of neighbours' differences that are no chance.
_SURE_DIFFERENCE = 4.0


def wrong_share(ordinates: Ordinates, fitted: Fits, model: NoiseModel, series: AxisSeries) -> float:
    """Return the share by which N may be wrong; 0 if the model has no slow noise and the neighbours agree."""
    share = 0.0
    if any(term.symbol not in _FAST for term in model.terms):
        share = max(_WITH_SLOW, _slow_share(ordinates, fitted))
    ends = [segment.stop for segment in series.clock.segments[:-1]]
    differences = np.delete(np.diff(series.samples), np.array(ends, dtype=np.int64) - 1)
    seen = 0.5 * float(np.sum(differences**2))
    expected = differences.size * float(model.avar(np.array([1.0]), rate_hz=series.rate_hz)[0])
    if seen > 0 and expected > 0:
        wrong = abs(float(np.log(seen / expected)))
        if wrong > _SURE_DIFFERENCE * float(np.sqrt(3 / differences.size)):
            share = max(share, wrong)
    return share


def _slow_share(ordinates: Ordinates, fitted: Fits) -> float:
    """Return the share of the spectrum at `WHITE_FROM` that is not white noise; 0 in a model without any."""
    white = COLUMN["N"]
    if not fitted.models.has[0, white]:
        return 0.0
    place = int(np.argmin(np.abs(ordinates.fraction - WHITE_FROM)))
    density = float(np.exp(fitted.theta[0, white]) * ordinates.basis[white, place])
    return 1 - density / float(fitted.spectrum[0, place])


def sparse_factor(estimates: Sequence[Estimate], share: float) -> float:
    """Return the factor by which intervals widen, so that N's limits move away by a share of N."""
    white = next(estimate for estimate in estimates if estimate.symbol == "N")
    if not share or white.value is None or white.low <= 0:
        return 1.0
    nearer = float(np.log(min(white.high / white.value, white.value / white.low)))
    return 1 + share / max(nearer, _NARROWEST)


def sparse_finding(factor: float, axis: str) -> tuple[Finding, ...]:
    """Return the warning about wider intervals; nothing for a factor of 1."""
    if factor <= 1:
        return ()
    text = (
        "Slow noise changes the completion of the missing samples, so N may be wrong by more than chance: "
        f"all intervals are {factor:.2g} times as wide to allow for it."
    )
    advice = "Record without losses, or use a part of the log with fewer."
    return (Finding("warning", "gaps-in-fit", text, advice, axis=axis),)

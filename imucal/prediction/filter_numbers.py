"""Two numbers that a filter can be held to: white noise and a walk that cover the fitted spectrum.

Most filters take a density of white noise N and one of the bias's random walk K. For any linear
weights H, fixed or varying in time, the variance of a filter's error is the integral of |H|² S over
frequency. So where N_f² + K_f² / omega² is at least the true spectrum S wherever H is not zero, the variance
that the filter predicts is at least the true one. N and K of a fit leave out its flicker and its
Gauss-Markov terms; the least pair that covers all of its spectrum does not. It holds for noise of
stationary increments, a filter that does not know the bias at its start, and axes without correlation.

Source: Langel, Garcia Crespillo & Joerger (2021), "Overbounding the effect of uncertain Gauss-Markov noise in
Kalman filtering", NAVIGATION 68, 259 (the idea; abstract); the rule is measured in
`tests/benchmarks/consistency.py`.
"""

import math
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from imucal.arguments import takes
from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError
from imucal.fitting.noise_fit import NoiseFit
from imucal.frozen import frozen
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS, GaussMarkov, RateRamp
from imucal.prediction.propagation import MEAN, Caution, Quantity, modelled, upper_limit

#: Of several axes: the largest at each frequency, or the mean of their psds.
Joined: TypeAlias = Literal["worst", "rms"]
Join: TypeAlias = Callable[..., FloatArray]

#: One-sided level at which one axis's spectrum is covered. Of several axes the largest of their means is.
LEVEL = 0.8
#: Horizon and step where nobody says: how long a filter may coast, and how often it is aided, in s.
HORIZON_S, STEP_S = 300.0, 1.0
#: Cameras and lidars are seldom blind for longer than this, in s; satellites may be gone for minutes.
CAMERA_HORIZON_S = 60.0
#: A time of coasting at which the price of a pair is said, in s.
PRICED_S = (1.0, 10.0, 60.0, 300.0, 1000.0)
#: Lowest frequency that is covered, over the horizon: a filter remembers its bias for longer than it
#: coasts. A Gauss-Markov bias forgets.
_LOWEST, _LOWEST_BOUND_BIAS = 0.01, 0.5
_FREQUENCIES, _TIMES, _PAIRS = 90, 25, 600
#: How far down the search for a walk goes, in power from the walk that covers everything alone.
_SMALLEST = 1e-12
#: A ramp has no spectrum: this times horizon R² is the K² whose Allan variance is the ramp's at the horizon.
_RAMP = 1.5
#: Programs refuse a walk or white noise of zero: a share of the other's deviation that no filter sees.
_NOTHING = 1e-3
#: A bias's process is drawn so many times a step.
_FINE = 64
#: Averaging times are whole samples: so far beside step and horizon they count.
_ROUNDING = 0.01
#: A bias without a measured correlation time gets one so many horizons long, so that it stays a walk.
_LONG = 10.0


@frozen
class FilterNumbers:
    """White noise and a slow bias that cover the spectrum of one axis or several.

    Attributes
    ----------
    white, walk
        N_f in U/sqrt(Hz) and K_f in U/s/sqrt(Hz); of a Gauss-Markov bias the density that drives it.
    correlation_time_s
        T of a first-order Gauss-Markov bias, in s; None for a walk.
    horizon_s, step_s
        How long the filter may coast, and how often it is aided at most.
    level
        One-sided level at which the spectrum is covered; None for the mean over what the records leave open.
    ratios
        (t, ratio): predicted over modelled Allan deviation at t, in s.
    price
        The mean of such ratios from the step to the horizon, against the upper limit of what was covered.
    basis
        ``spectrum`` of the model, or ``curve``: the upper limits of the Allan curve, without a model.
    """

    white: float
    walk: float
    correlation_time_s: float | None = None
    horizon_s: float
    step_s: float
    level: float | None
    ratios: tuple[tuple[float, float], ...]
    price: float
    basis: Literal["spectrum", "curve"] = "spectrum"

    @property
    def sigma(self) -> float:
        """Steady-state deviation of a Gauss-Markov bias, in U; infinite for a walk."""
        time = self.correlation_time_s
        return math.inf if time is None else self.walk * math.sqrt(time / 2)


@takes('imucal.filter_numbers([report["gyro_x"].fit])', fits=[NoiseFit])
def filter_numbers(
    fits: Sequence[NoiseFit],
    *,
    horizon_s: float = HORIZON_S,
    step_s: float = STEP_S,
    joined: Joined = "worst",
    time_s: float | None = None,
) -> FilterNumbers:
    """Return the least white noise and walk that cover the spectra of some axes.

    Least means: of all pairs that cover, the one whose Allan variance is nearest to that of the fits, in
    the mean logarithm from the step to the horizon. A fit without a likelihood (``slope``, or of a table
    of deviations) is covered by the upper limits of its Allan curve.

    Parameters
    ----------
    fits
        Of the axes that the pair is for, at least one.
    horizon_s
        How long the filter may coast.
    step_s
        How often it is aided: noise faster than that is not covered.
    joined
        Of several axes: the largest at each frequency, or the root of their mean psd.
    time_s
        Correlation time of a Gauss-Markov bias in place of the walk.

    Raises
    ------
    ValueError
        If there is no fit, or a time is not positive, or the horizon is not longer than the step.
    DataError
        If the fits know nothing of the noise.
    """
    if not fits or not 0 < step_s < horizon_s < math.inf or not (time_s is None or time_s > 0):
        msg = (
            f"expected fits and 0 < step < horizon, got {len(fits)} fits, step {step_s:g} s, horizon "
            f"{horizon_s:g} s, time {time_s}; give a horizon longer than the step"
        )
        raise ArgumentError(msg)
    caution = Caution.at(LEVEL, fits[0].level) if len(fits) == 1 else MEAN
    join: Join = np.max if joined == "worst" else np.mean
    bias = TERMS["K"].of(1.0) if time_s is None else GaussMarkov(sigma=math.sqrt(time_s / 2), T=time_s)

    def drift(t: FloatArray) -> FloatArray:
        return bias.avar(t * _FINE / step_s, step_s / _FINE)

    if any(map(_has_no_likelihood, fits)):
        goal = _of_curves(fits, drift, step_s, horizon_s)
    else:
        goal = _of_spectra(fits, bias, (step_s, horizon_s), join, caution)
    if not np.max(goal.wanted) > 0:
        raise DataError("found no term and no bound; expected noise to cover; record for longer")
    if not np.all(np.isfinite(goal.wanted)):
        msg = "found a term without an upper limit; expected limits for all terms; record for longer"
        raise DataError(msg)
    # A walk that covers everything alone, and every smaller one with the white noise that it lacks.
    walks = float(np.max(goal.wanted / goal.slow)) * np.concatenate(
        [[0.0], np.geomspace(_SMALLEST, 1.0, _PAIRS)]
    )
    whites = np.maximum(np.max((goal.wanted - np.outer(walks, goal.slow)) / goal.white, axis=1), 0.0)
    walks += _RAMP * horizon_s * max(_ramp(fit, caution) for fit in fits) ** 2
    walks = np.maximum(walks, _NOTHING**2 * 3 * whites / horizon_s**2)
    whites = np.maximum(whites, _NOTHING**2 * walks * step_s**2 / 3)
    avar = np.outer(whites, 1 / goal.t) + np.outer(walks, drift(goal.t))
    prices = np.mean(np.log(avar / goal.avar), axis=1)
    best = int(np.argmin(prices))
    return FilterNumbers(
        white=math.sqrt(whites[best]),
        walk=math.sqrt(walks[best]),
        correlation_time_s=time_s,
        horizon_s=horizon_s,
        step_s=step_s,
        level=LEVEL if len(fits) == 1 else None,
        ratios=_ratios(fits, lambda t: whites[best] / t + walks[best] * drift(t), step_s, join),
        price=math.exp(prices[best] / 2),
        basis=goal.basis,
    )


def _has_no_likelihood(fit: NoiseFit) -> bool:
    """Return whether a fit is of lines read off, or of a curve without samples, whose limits are known."""
    given = fit.curve.computed == "given" and bool(np.isfinite(fit.curve.edf).all())
    return fit.method == "slope" or given


def usual_pairs(fits: Sequence[NoiseFit]) -> tuple[FilterNumbers, ...]:
    """Return the pairs for filters with cameras or lidars, and for others; none where nothing is known."""
    try:
        return tuple(filter_numbers(fits, horizon_s=horizon) for horizon in (CAMERA_HORIZON_S, HORIZON_S))
    except DataError:
        return ()


def correlation_times(fits: Sequence[NoiseFit], *, horizon_s: float = HORIZON_S) -> tuple[float, ...]:
    """Return the times that a Gauss-Markov bias may have, in s: those of the fits' terms, the longest first.

    The first is long against horizon and record, so that the bias is a walk to the filter.
    """
    record = max(fit.curve.n / fit.rate_hz for fit in fits)
    times = (
        e.correlation_time.value for fit in fits for e in fit.estimates if e.value and e.correlation_time
    )
    return (max(_LONG * horizon_s, record), *sorted(set(times), reverse=True))


class _Goal(NamedTuple):
    """What is to be covered by white noise and a slow bias of unit power, and what is to be met.

    `wanted`, `white` and `slow` stand at the same frequencies or times; `avar` at the times `t`.
    """

    wanted: FloatArray
    white: FloatArray
    slow: FloatArray
    t: FloatArray
    avar: FloatArray
    basis: Literal["spectrum", "curve"]


def _of_spectra(
    fits: Sequence[NoiseFit], bias: NoiseTerm, within: tuple[float, float], join: Join, caution: Caution
) -> _Goal:
    """Return the fits' psds, as of samples a step apart, up to half its rate; `within` is step, horizon."""
    step_s, horizon_s = within
    t = np.geomspace(step_s, horizon_s, _TIMES)
    lowest = _LOWEST_BOUND_BIAS if isinstance(bias, GaussMarkov) else _LOWEST
    f = covered_frequencies(horizon_s, step_s, lowest=lowest)
    psds = [upper_limit(fit, lambda term: term.psd(f, step_s), caution) for fit in fits]
    avars = [upper_limit(fit, _avar(t, fit.rate_hz), caution) for fit in fits]
    return _Goal(join(psds, axis=0), np.ones_like(f), bias.psd(f, step_s), t, join(avars, axis=0), "spectrum")


def covered_frequencies(horizon_s: float, step_s: float, *, lowest: float = _LOWEST) -> FloatArray:
    """Return the frequencies at which a spectrum is covered, shape (f,), in Hz; `lowest` over the horizon."""
    return np.geomspace(lowest / horizon_s, 0.5 / step_s, _FREQUENCIES)


def _of_curves(
    fits: Sequence[NoiseFit], drift: Callable[[FloatArray], FloatArray], step_s: float, horizon_s: float
) -> _Goal:
    """Return the upper limits of all curves within the horizon, or their values where those are unknown.

    Times beyond a curve's end are not in it: a short record says nothing of them.
    """
    times, upper = [], []
    for fit in fits:
        curve = fit.curve
        high = curve.confidence_interval(fit.level)[1] ** 2
        within = (curve.tau >= step_s * (1 - _ROUNDING)) & (curve.tau <= horizon_s * (1 + _ROUNDING))
        within |= curve.tau == curve.tau[np.argmin(np.abs(np.log(curve.tau / step_s)))]
        times.append(curve.tau[within])
        upper.append(np.where(np.isfinite(high), high, curve.avar)[within])
    t, wanted = np.concatenate(times), np.concatenate(upper)
    return _Goal(wanted, 1 / t, drift(t), t, wanted, "curve")


def _avar(t: FloatArray, rate_hz: float) -> Quantity:
    """Return what asks a term for its Allan variance at the averaging times nearest to t."""
    m = np.maximum(np.round(t * rate_hz), 1.0)
    return lambda term: term.avar(m, 1 / rate_hz)


def _ramp(fit: NoiseFit, caution: Caution) -> float:
    """Return the ramp to cover, in U/s: its upper limit of one axis, its value of several."""
    ramps = (e for e in fit.estimates if e.symbol == RateRamp.symbol)
    return max((e.high if caution.shown else e.value or 0.0 for e in ramps), default=0.0)


def _ratios(
    fits: Sequence[NoiseFit], predicted: Callable[[FloatArray], FloatArray], step_s: float, join: Join
) -> tuple[tuple[float, float], ...]:
    """Return predicted over modelled deviation at the times that are priced."""
    t = np.array([time for time in PRICED_S if time >= step_s])
    model = join([modelled(fit, _avar(t, fit.rate_hz)) for fit in fits], axis=0)
    known = model > 0
    ratios = np.sqrt(predicted(t[known]) / model[known])
    return tuple(zip(t[known].tolist(), ratios.tolist(), strict=True))

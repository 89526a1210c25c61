"""Two numbers for a filter: white noise and a random walk that cover the fitted spectrum.

For any linear weights H, the variance of a filter's error is the integral of |H|² S over frequency. If
N_f² + K_f² / omega² is at least the true spectrum S wherever H is not zero, the variance that the filter
predicts is at least the true one. The rule is valid for noise with stationary increments, a filter that
starts without knowledge of the bias, and uncorrelated axes.

Source: Langel, Garcia Crespillo & Joerger (2021), "Overbounding the effect of uncertain Gauss-Markov noise in
Kalman filtering", NAVIGATION 68, 259 (the idea; abstract); the rule is measured in
`tests/benchmarks/consistency.py`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError
from imucal.fitting.noise_fit import NoiseFit
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS, GaussMarkov, RateRamp
from imucal.prediction.propagation import MEAN, Caution, Quantity, modelled, upper_limit

#: How to join several axes: the largest at each frequency, or the mean of their psds.
Joined: TypeAlias = Literal["worst", "rms"]
Join: TypeAlias = Callable[..., FloatArray]

#: One-sided level at which the spectrum of a single axis is covered.
LEVEL = 0.8
#: How long a filter may coast by default, in s.
HORIZON_S = 300.0
#: How often a filter is aided by default, in s.
STEP_S = 1.0
#: Horizon for cameras and lidars, in s; satellites may be lost for longer.
CAMERA_HORIZON_S = 60.0
#: Times of the reported ratios, in s.
PRICED_S = (1.0, 10.0, 60.0, 300.0, 1000.0)
#: Lowest covered frequency times the horizon, for a walk: a filter remembers it for longer than it coasts.
_LOWEST = 0.01
#: The same for a Gauss-Markov bias.
_LOWEST_BOUND_BIAS = 0.5
#: Number of covered frequencies, evenly spaced in the logarithm.
_FREQUENCIES = 90
#: Number of times, from the step to the horizon, at which Allan variances are compared.
_TIMES = 25
#: Number of pairs that are tried.
_PAIRS = 600
#: Smallest walk of the search, relative to the walk that covers everything alone, in power.
_SMALLEST = 1e-12
#: K² over horizon R² of a walk that covers a ramp, which has no spectrum.
_RAMP = 1.5
#: Share of the other's deviation in place of zero, which programs refuse.
_NOTHING = 1e-3
#: Samples per step of the bias's process.
_FINE = 64
#: Relative tolerance, because averaging times are whole samples.
_ROUNDING = 0.01
#: Correlation time, in horizons, of a bias without a measured one.
_LONG = 10.0


@dataclass(frozen=True, kw_only=True)
class FilterNumbers:
    """White noise and a slow bias that cover the spectrum of one axis or several.

    Attributes
    ----------
    white, walk
        N_f in U/sqrt(Hz) and K_f in U/s/sqrt(Hz), or the density that drives a Gauss-Markov bias.
    correlation_time_s
        T of a first-order Gauss-Markov bias; None for a walk.
    horizon_s, step_s
        How long the filter may coast, and how often it is aided at most.
    level
        One-sided level at which the spectrum is covered; None for the mean over the fits' uncertainty.
    ratios
        (t, ratio): predicted over modelled Allan deviation at t, in s.
    excess
        Mean ratio of predicted Allan deviation to the upper limit to cover.
    basis
        ``spectrum`` of the model, or ``curve``: the upper limits of the Allan curve.
    """

    white: float
    walk: float
    correlation_time_s: float | None = None
    horizon_s: float
    step_s: float
    level: float | None
    ratios: tuple[tuple[float, float], ...]
    excess: float
    basis: Literal["spectrum", "curve"] = "spectrum"

    def slow_avar(self, t: FloatArray) -> FloatArray:
        """Return the Allan variance of the slow bias at times in s, in U²."""
        return self.walk**2 * _drift_of(self.correlation_time_s, self.step_s)(t)

    @property
    def sigma(self) -> float:
        """Steady-state deviation of a Gauss-Markov bias, in U; infinite for a walk."""
        time = self.correlation_time_s
        return math.inf if time is None else self.walk * math.sqrt(time / 2)


def filter_numbers(
    fits: Sequence[NoiseFit],
    *,
    horizon_s: float = HORIZON_S,
    step_s: float = STEP_S,
    joined: Joined = "worst",
    time_s: float | None = None,
) -> FilterNumbers:
    """Return the least white noise and walk that are enough for the spectra of some axes.

    The least pair is the covering pair whose Allan variance is nearest to the fits', in the mean logarithm
    from the step to the horizon. For a fit without a likelihood the upper limits of its Allan curve are
    covered.

    Parameters
    ----------
    fits
        Fits of the axes, at least one.
    horizon_s
        How long the filter may coast.
    step_s
        How often it is aided: faster noise is not covered.
    joined
        How to join several axes: the largest at each frequency, or the root of their mean psd.
    time_s
        Correlation time of a Gauss-Markov bias in place of the walk.

    Raises
    ------
    ValueError
        If there is no fit, or a time is not positive, or the horizon is not longer than the step.
    DataError
        If the fits contain no information on the noise.
    """
    if not fits or not 0 < step_s < horizon_s < math.inf or not (time_s is None or time_s > 0):
        msg = (
            f"expected fits and 0 < step < horizon, got {len(fits)} fits, step {step_s:g} s, horizon "
            f"{horizon_s:g} s, time {time_s}; give a horizon longer than the step"
        )
        raise ArgumentError(msg)
    caution = Caution.at(LEVEL, fits[0].level) if len(fits) == 1 else MEAN
    join: Join = np.max if joined == "worst" else np.mean
    bias, drift = _unit_bias(time_s), _drift_of(time_s, step_s)
    if any(map(_has_no_likelihood, fits)):
        goal = _of_curves(fits, drift, step_s, horizon_s)
    else:
        goal = _of_spectra(fits, bias, (step_s, horizon_s), join, caution)
    if not np.max(goal.wanted) > 0:
        raise DataError("found no term and no bound; expected noise to cover; record for longer")
    if not np.all(np.isfinite(goal.wanted)):
        msg = "found a term without an upper limit; expected limits for all terms; record for longer"
        raise DataError(msg)
    # The walk that covers everything alone, and smaller ones.
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
        excess=math.exp(prices[best] / 2),
        basis=goal.basis,
    )


def _unit_bias(time_s: float | None) -> NoiseTerm:
    """Return a walk, or a Gauss-Markov bias, whose driving noise has the density 1."""
    return TERMS["K"].of(1.0) if time_s is None else GaussMarkov(sigma=math.sqrt(time_s / 2), T=time_s)


def _drift_of(time_s: float | None, step_s: float) -> Callable[[FloatArray], FloatArray]:
    """Return the Allan variance of this bias, as a function of the time in s."""
    bias = _unit_bias(time_s)
    return lambda t: bias.avar(t * _FINE / step_s, step_s / _FINE)


def _has_no_likelihood(fit: NoiseFit) -> bool:
    """Whether a fit is by slopes, or of a curve without samples but with known limits."""
    given = fit.curve.computed == "given" and bool(np.isfinite(fit.curve.edf).all())
    return fit.method == "slope" or given


def correlation_times(fits: Sequence[NoiseFit], *, horizon_s: float = HORIZON_S) -> tuple[float, ...]:
    """Return possible correlation times of a Gauss-Markov bias, in s, longest first.

    The first is so long that the bias is a walk for the filter.
    """
    record = max(fit.curve.n / fit.rate_hz for fit in fits)
    times = (
        e.correlation_time.value for fit in fits for e in fit.estimates if e.value and e.correlation_time
    )
    return (max(_LONG * horizon_s, record), *sorted(set(times), reverse=True))


class _Goal(NamedTuple):
    """The target to cover with white noise and a slow bias of unit power, and the avar to approach."""

    wanted: FloatArray
    white: FloatArray
    slow: FloatArray
    t: FloatArray
    avar: FloatArray
    basis: Literal["spectrum", "curve"]


def _of_spectra(
    fits: Sequence[NoiseFit], bias: NoiseTerm, within: tuple[float, float], join: Join, caution: Caution
) -> _Goal:
    step_s, horizon_s = within
    t = np.geomspace(step_s, horizon_s, _TIMES)
    lowest = _LOWEST_BOUND_BIAS if isinstance(bias, GaussMarkov) else _LOWEST
    f = covered_frequencies(horizon_s, step_s, lowest=lowest)
    psds = [upper_limit(fit, lambda term: term.psd(f, step_s), caution) for fit in fits]
    avars = [upper_limit(fit, _avar(t, fit.rate_hz), caution) for fit in fits]
    return _Goal(join(psds, axis=0), np.ones_like(f), bias.psd(f, step_s), t, join(avars, axis=0), "spectrum")


def covered_frequencies(horizon_s: float, step_s: float, *, lowest: float = _LOWEST) -> FloatArray:
    """Return the frequencies to cover, in Hz."""
    return np.geomspace(lowest / horizon_s, 0.5 / step_s, _FREQUENCIES)


def _of_curves(
    fits: Sequence[NoiseFit], drift: Callable[[FloatArray], FloatArray], step_s: float, horizon_s: float
) -> _Goal:
    """Return the upper limits of all curves within the horizon, or their values."""
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
    m = np.maximum(np.round(t * rate_hz), 1.0)
    return lambda term: term.avar(m, 1 / rate_hz)


def _ramp(fit: NoiseFit, caution: Caution) -> float:
    """Return the ramp to cover, in U/s: the upper limit for one axis, the value for several."""
    ramps = (e for e in fit.estimates if e.symbol == RateRamp.symbol)
    return max((e.high if caution.shown else e.value or 0.0 for e in ramps), default=0.0)


def _ratios(
    fits: Sequence[NoiseFit], predicted: Callable[[FloatArray], FloatArray], step_s: float, join: Join
) -> tuple[tuple[float, float], ...]:
    t = np.array([time for time in PRICED_S if time >= step_s])
    model = join([modelled(fit, _avar(t, fit.rate_hz)) for fit in fits], axis=0)
    known = model > 0
    ratios = np.sqrt(predicted(t[known]) / model[known])
    return tuple(zip(t[known].tolist(), ratios.tolist(), strict=True))

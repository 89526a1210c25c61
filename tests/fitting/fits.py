"""Helpers that make fits for the tests."""

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.arrays import FloatArray
from imucal.fitting import FitSettings
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.fitting.spectral import fit_mle
from imucal.fitting.spectral.blocks import Block, bin_blocks
from imucal.fitting.spectral.bounds import estimate_or_bound, with_absent
from imucal.fitting.spectral.estimates import Problem
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.models import Models, models_of
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.fitting.spectral.selection import choose
from imucal.noise.model import NoiseModel, parse_structure
from imucal.recording import AxisSeries

__all__ = ["at_maximum", "estimated", "fitted", "no_curve", "ordinates_of", "simulated"]


def simulated(text: str, n: int, seed: int, *, rate_hz: float = 1.0) -> FloatArray:
    """Return samples of a model text."""
    return NoiseModel.parse(text).simulate(n, rate_hz=rate_hz, rng=np.random.default_rng(seed))


def no_curve(n: int) -> AllanCurve:
    """Return a placeholder curve; maximum likelihood returns it without using it."""
    two = np.array([1.0, 2.0])
    return AllanCurve(tau=two, m=np.array([1, 2]), avar=two, edf=two, n=n)


def fitted(
    samples: FloatArray | AxisSeries,
    model: str = "auto",
    *,
    rate_hz: float = 1.0,
    level: float = 0.95,
    criterion: str = "chance",
    max_gm: int = 2,
    temperature: FloatArray | None = None,
) -> NoiseFit:
    """Return the maximum-likelihood fit of samples, or of a series."""
    series = samples
    if not isinstance(series, AxisSeries):
        series = AxisSeries.from_samples(series, rate_hz=rate_hz).finite()
    return fit_mle(
        series,
        no_curve(series.n),
        FitSettings(model=model, level=level, criterion=criterion, max_gm=max_gm),
        temperature,
    )


def ordinates_of(samples: FloatArray) -> Ordinates:
    """Return the binned ordinates of samples without gaps, with the ramp as regressor."""
    bins = dct_bins(samples.size)
    return bin_blocks([Block(offset=0, bins=bins, ordinates=dct_ordinates(samples))], 1.0)


def at_maximum(
    theta: FloatArray,
    *,
    objective: FloatArray,
    models: Models | None = None,
    information: FloatArray | None = None,
    beta: FloatArray | None = None,
    beta_covariance: FloatArray | None = None,
) -> Fits:
    """Return a likelihood at rows of parameters with zero gradient; omitted arrays are empty or zero."""
    rows, size = theta.shape
    return Fits(
        models=models_of([("N",)] * rows, ()) if models is None else models,
        theta=theta,
        objective=objective,
        score=np.zeros(theta.shape),
        information=np.zeros((rows, size, size)) if information is None else information,
        beta=np.zeros((rows, 0)) if beta is None else beta,
        beta_covariance=np.zeros((rows, 0, 0)) if beta_covariance is None else beta_covariance,
        spectrum=np.ones((rows, 0)),
    )


def estimated(samples: FloatArray, model: str, *, level: float = 0.95) -> dict[str, Estimate]:
    """Return the estimates of a given model on the full band, without a search for a filter."""
    data = ordinates_of(samples)
    choice = choose(data, [parse_structure(model)], criterion="bic")
    problem = Problem(ordinates=data, level=level, tau0=1.0, widening={})
    return {e.key: e for e in with_absent(problem, *estimate_or_bound(problem, choice))}

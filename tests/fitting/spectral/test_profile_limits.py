"""Tests of profile-likelihood limits, with a likelihood whose drop is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import BoolArray, FloatArray
from imucal.fitting.spectral import estimates
from imucal.fitting.spectral.estimates import RAMP, _ProfileSearch, profile_limits, quantile
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.maximum import bounds
from imucal.fitting.spectral.models import Models, models_of
from imucal.fitting.spectral.ordinates import Ordinates
from tests.fitting.fits import at_maximum, ordinates_of, simulated

#: Columns of the variances of N and of a Gauss-Markov term, and of its time.
N, SIGMA, TIME = 1, 4, 5
DATA = ordinates_of(simulated("N=1", 3000, 1))
MODELS = models_of([("N", "GM", "R")], DATA.names)
CENTRE = np.array([0.0, 0.2, 0.0, 0.0, 0.4, np.log(50.0)])
BETA, PEAK = 0.3, 7.0


def maximum(information: FloatArray | None = None) -> Fits:
    """Return the maximum of the likelihood."""
    width = CENTRE.size
    return at_maximum(
        CENTRE[None].copy(),
        models=MODELS,
        objective=np.array([PEAK]),
        information=(np.eye(width) if information is None else information)[None],
        beta=np.array([[BETA]]),
        beta_covariance=np.array([[[0.04]]]),
    )


def known(monkeypatch: pytest.MonkeyPatch, deviation: float) -> list[BoolArray]:
    """Make the log-likelihood a parabola in each u with this deviation; return the free parameters."""
    seen: list[BoolArray] = []

    def drop(
        ordinates: Ordinates,
        models: Models,
        theta: FloatArray,
        *,
        free: BoolArray,
        ramp: FloatArray,
        **options: Any,  # noqa: ANN401
    ) -> Fits:
        del ordinates, options
        seen.append(free)
        assert models.count == len(theta) == len(free) == ramp.size
        away = [np.exp(theta[:, c] / 2) - np.exp(CENTRE[c] / 2) for c in (N, SIGMA)]
        away += [theta[:, TIME] - CENTRE[TIME], np.where(np.isnan(ramp), 0.0, ramp - BETA)]
        objective = PEAK + sum(0.5 * (part / deviation) ** 2 for part in away)
        return replace(maximum(), theta=theta, objective=np.asarray(objective))

    monkeypatch.setattr(estimates, "maximize", drop)
    return seen


def limits(columns: list[int], level: float = 0.95) -> tuple[FloatArray, FloatArray]:
    """Return the limits of some columns."""
    reach = np.full(len(columns), quantile(level))
    return profile_limits(DATA, maximum()[[0] * len(columns)], np.array(columns), reach=reach)


def test_the_quantile_is_two_sided() -> None:
    """It is 1.96 for 95 % and 1 for 68.27 %."""
    assert quantile(0.95) == pytest.approx(1.959964, abs=1e-6)
    assert quantile(0.6826895) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
def test_the_likelihood_drop_at_the_limits_is_the_quantile(
    level: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Limits are exact to 0.01 z, for a deviation, the logarithm of a time and a slope."""
    seen, z = known(monkeypatch, 0.1), quantile(level)
    low, high = limits([N, SIGMA, TIME, RAMP], level)
    for column, at in ((N, 0), (SIGMA, 1)):
        npt.assert_allclose(
            [np.exp(low[at] / 2), np.exp(high[at] / 2)],
            np.exp(CENTRE[column] / 2) + np.array([-1, 1]) * 0.1 * z,
            atol=0.0011 * z,
        )
    npt.assert_allclose([low[2], high[2]], CENTRE[TIME] + np.array([-1, 1]) * 0.1 * z, atol=0.0011 * z)
    npt.assert_allclose([low[3], high[3]], BETA + np.array([-1, 1]) * 0.1 * z, atol=0.0011 * z)
    # The profiled parameter is fixed; a ramp is a regressor, so nothing is fixed for it.
    free = MODELS.free[0]
    for row, profiled in enumerate((N, SIGMA, TIME, None) * 2):
        expected = free.copy()
        if profiled is not None:
            expected[profiled] = False
        npt.assert_array_equal(seen[0][row], expected)


def test_limits_are_infinite_if_the_likelihood_does_not_drop(monkeypatch: pytest.MonkeyPatch) -> None:
    """The drop stays below the quantile up to the bound."""
    known(monkeypatch, 5.0)
    low, high = limits([N, TIME, RAMP])
    assert low[:2].tolist() == [-np.inf, -np.inf]
    assert high[1] == np.inf
    assert np.exp(high[0] / 2) == pytest.approx(np.exp(CENTRE[N] / 2) + 5 * 1.96, abs=0.11)
    npt.assert_allclose([low[2], high[2]], BETA + np.array([-9.8, 9.8]), atol=0.11)


def search(columns: list[int], information: FloatArray | None = None) -> _ProfileSearch:
    """Return a search from the maximum."""
    return _ProfileSearch(DATA, maximum(information)[[0] * len(columns)], np.array(columns))


def test_the_start_and_the_bounds_of_a_search() -> None:
    """It starts at the estimate in u; variances and ramps have no upper bound, ramps no lower one."""
    found = search([N, TIME, RAMP])
    npt.assert_allclose(found.centre, [np.exp(0.1), CENTRE[TIME], BETA])
    low, high = bounds(DATA, MODELS)
    npt.assert_allclose(found.low, [np.exp(low[N] / 2), low[TIME], -np.inf])
    npt.assert_allclose(found.high, [np.inf, high[TIME], np.inf])
    npt.assert_allclose(found.from_u(np.arange(3), np.array([2.0, 2.0, 2.0])), [2 * np.log(2.0), 2.0, 2.0])


@pytest.mark.parametrize(
    ("curvature", "width"), [(100.0, 0.5 * 0.1), (1.0 + 1e-9, 0.5), (0.25, 1.0), (0.16, 1.0)]
)
def test_the_first_step_of_a_variance(curvature: float, width: float) -> None:
    """It is half the relative standard error times u, at most u."""
    information = np.eye(CENTRE.size)
    information[SIGMA, SIGMA] = curvature
    step = search([SIGMA], information).width
    assert step[0] == pytest.approx(width * np.exp(CENTRE[SIGMA] / 2), rel=1e-6)


def test_the_first_steps_of_a_time_and_a_ramp() -> None:
    """They are the standard error of the logarithm, at most one, and of the slope."""
    for curvature, width in ((4.0, 0.5), (0.25, 1.0)):
        information = np.eye(CENTRE.size)
        information[TIME, TIME] = curvature
        npt.assert_allclose(search([TIME, RAMP], information).width, [width, 0.2])


def test_the_first_step_of_a_tiny_variance_is_at_a_visible_level() -> None:
    """It is six log units of u above the bound instead of u."""
    information = np.eye(CENTRE.size)
    information[N, N] = 1e-4
    found = search([N], information)
    found.centre[:] = 1e-9
    step = found._width(maximum(information), np.full(CENTRE.size, -20.0))
    assert step[0] == pytest.approx(np.exp(-4.0))

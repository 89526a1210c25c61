"""Tests of the search for a maximum: bounds, steps, covariance and misfit."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import numpy.testing as npt
import pytest

from imucal.fitting.spectral.likelihood import covariance, evaluate
from imucal.fitting.spectral.maximum import (
    _step,
    bounds,
    given_up,
    maximize,
    misfit,
    misfit_factors,
)
from imucal.fitting.spectral.models import models_of
from tests.fitting.fits import ordinates_of, simulated


def test_bounds_of_a_time_and_of_a_variance() -> None:
    """A time is between the shortest and twice the record, a variance above exp(-18) of the visible level."""
    data = ordinates_of(simulated("N=1 + K=0.05", 500, 1))
    models = models_of([("N", "GM")], data.names, poles=1, shortest=7.0)
    low, high = bounds(data, models)
    assert np.exp(low[5]) == pytest.approx(7.0)
    assert np.exp(high[5]) == pytest.approx(1000.0)
    assert np.isposinf(high[[0, 1, 2, 3, 4, 6]]).all()
    assert np.isneginf(low[6])
    groups = [slice(at, at + 8) for at in range(0, data.size.size, 8)]
    level = np.array([data.power[g].sum() / data.size[g].sum() for g in groups])
    visible = (level / data.basis[:, ::8]).min(axis=1)
    npt.assert_allclose(low[:4], np.log(visible) - 18, rtol=1e-12)
    assert low[4] == pytest.approx(np.log(level.min() / 500) - 18)


def test_a_step_is_at_most_one_and_a_half() -> None:
    """The unit is a logarithm, or 1 + the size of a response; a parameter at its bound does not move."""
    data = ordinates_of(simulated("N=1 + K=0.05", 500, 1))
    models = models_of([("N", "K")], data.names, poles=1)
    low, high = bounds(data, models)
    theta = np.array([[0.0, -12.0, 0.0, -14.0, 0.0]])
    state = evaluate(data, models, theta)
    rows, damping = np.array([0]), np.array([1e-9])
    score = np.array([[0.0, -1e9, 0.0, 1e9, -1e9]])
    state.score[:] = score
    moved = _step(state, rows, models.free, damping, limits=(low, high)) - theta
    assert np.abs(moved).max() == pytest.approx(1.5)
    assert moved[0, 0] == moved[0, 2] == 0.0
    theta[0, 4] = 3.0
    state.information[:] = np.eye(5)
    moved = _step(state, rows, models.free, damping, limits=(low, high)) - theta
    npt.assert_allclose(moved, [[0.0, 1.5, 0.0, -1.5, 6.0]])
    at_bound = np.where(np.isfinite(low), low, theta)
    bounded = replace(state, theta=at_bound)
    moved = _step(bounded, rows, models.free, damping, limits=(low, high)) - at_bound
    npt.assert_allclose(moved, [[0.0, 1.5, 0.0, 0.0, 6.0]])


def test_a_search_ends_at_a_zero_of_the_score() -> None:
    """One step from far away is not enough; a fixed parameter does not move."""
    data = ordinates_of(simulated("N=1 + K=0.05", 500, 1))
    models = models_of([("N", "K")], data.names)
    start = np.array([[0.0, -9.0, 0.0, 3.0]])
    assert np.abs(maximize(data, models, start, iterations=1).score).max() > 1.0
    found = maximize(data, models, start)
    assert np.abs(found.score).max() < 1e-3
    npt.assert_array_equal(found.score, evaluate(data, models, found.theta).score)
    held = np.array([[False, True, False, False]])
    partly = maximize(data, models, start, free=held)
    assert partly.theta[0, 3] == 3.0
    assert partly.objective[0] > found.objective[0]


def test_undetermined_parameters_have_infinite_variance() -> None:
    """The other parameters have the covariance of a fit without them."""
    information = np.array([[4.0, 1.0, 0.0, 1.0], [1.0, 2.0, 0.0, 0.5], [0.0] * 4, [1.0, 0.5, 0.0, 3.0]])
    found = covariance(information, np.array([True, True, True, False]))
    npt.assert_allclose(found[:2, :2], np.linalg.inv(information[:2, :2]), rtol=1e-12)
    npt.assert_array_equal(np.diag(found)[2:], np.inf)
    npt.assert_array_equal(found[2:, :2], 0.0)


def test_the_misfit_agrees_with_its_definition() -> None:
    """The reference is a loop over groups of eight degrees of freedom."""
    data = ordinates_of(simulated("N=1 + K=0.05", 400, 2) + 0.01 * np.arange(400))
    model = models_of([("N", "R")], data.names)
    theta = np.zeros((1, 4))
    beta = evaluate(data, model, theta).beta[0, 0]
    ratio = data.power - 2 * beta * data.cross[0] + beta**2 * data.gram[0, 0]
    groups: dict[int, list[float]] = {}
    before = 0.0
    for size, value in zip(data.size.tolist(), ratio.tolist(), strict=True):
        group = groups.setdefault(int((before + size / 2) // 8), [0.0, 0.0])
        group[0], group[1] = group[0] + size, group[1] + value
        before += size
    squares = [(value - size) ** 2 / (2 * size) for size, value in groups.values()]
    spread = np.sqrt(sum(2 + 12 / size for size, _ in groups.values()))
    found = misfit(data, evaluate(data, model, theta))
    assert found.chi2_per_bin == pytest.approx(np.mean(squares), rel=1e-12)
    assert found.statistic == pytest.approx((sum(squares) - len(squares)) / spread, rel=1e-9)
    assert found.p_value == pytest.approx(NormalDist().cdf(-found.statistic), rel=1e-9)


def test_hopeless_candidates_are_given_up() -> None:
    """Candidates are kept in the first steps, if they gain a tenth of the gap, and if they are the best."""
    value, gain = np.array([100.0, 110.0, 180.0, 180.0]), np.array([0.0, 0.0, 1.0, 9.0])
    assert given_up(value, gain, 2).tolist() == [False] * 4
    assert given_up(value, gain, 3).tolist() == [False, False, True, False]
    assert given_up(value - [0, 0, 45, 45], gain, 11).tolist() == [False] * 4
    assert given_up(value - [0, -15, 45, 45], gain, 20).tolist() == [False, True, True, False]


def test_giving_up_candidates_does_not_change_the_best() -> None:
    """Near candidates end at identical parameters; the others may end at a higher objective."""
    data = ordinates_of(simulated("N=1 + K=0.05", 20_000, 3))
    structures = [("N",), ("N", "K"), ("N", "B", "K"), ("K",), ("Q", "N")]
    models = models_of(structures, data.names, shortest=7.0)
    start = np.tile(np.log(data.power.sum() / data.count / data.basis.mean(axis=1)), (5, 1))
    plain = maximize(data, models, start)
    raced = maximize(data, models, start, handicap=np.zeros(5))
    near = plain.objective < plain.objective.min() + 12.5
    assert 0 < near.sum() < 5
    npt.assert_array_equal(raced.theta[near], plain.theta[near])
    assert (raced.objective >= plain.objective - 1e-9).all()


def test_the_factor_of_the_only_term_is_the_root_of_the_mean_squared_residual() -> None:
    """White noise has equal weight in all groups; the data contain a random walk that the model lacks."""
    data = ordinates_of(simulated("N=1 + K=0.05", 400, 2))
    model = models_of([("N",)], data.names)
    theta = np.zeros((1, 4))
    size, squares = [], []
    for group in np.unique((np.cumsum(data.size) - data.size / 2) // 8):
        own = (np.cumsum(data.size) - data.size / 2) // 8 == group
        size.append(data.size[own].sum())
        squares.append((data.power[own].sum() - size[-1]) ** 2 / (2 * size[-1]))
    factors = misfit_factors(data, evaluate(data, model, theta))
    assert factors[1] == pytest.approx(np.sqrt(np.average(squares, weights=size)), rel=1e-9)


def test_a_misfit_only_affects_terms_at_its_frequencies() -> None:
    """A hump at high frequency widens N and does not change K."""
    data = ordinates_of(simulated("N=1 + K=0.05", 20_000, 3))
    model = models_of([("N", "K")], data.names)
    theta = np.array([[0.0, 0.0, 0.0, 2 * np.log(0.05)]])
    plain = misfit_factors(data, evaluate(data, model, theta))
    upper = np.cumsum(data.size) > 0.5 * data.size.sum()
    hump = replace(data, power=np.where(upper, 1.5 * data.power, data.power))
    found = misfit_factors(hump, evaluate(hump, model, theta))
    assert 0.8 < plain[1] < 1.2
    assert found[1] > 3.0
    assert found[3] == pytest.approx(plain[3], rel=0.01)


def test_an_absent_term_has_the_misfit_factor_of_its_frequencies() -> None:
    """An unmodelled random walk raises the lowest ordinates, so K's factor is large."""
    data = ordinates_of(simulated("N=1 + K=0.05", 20_000, 4))
    found = evaluate(data, models_of([("N",)], data.names), np.zeros((1, 4)))
    factors = misfit_factors(data, found)
    assert factors[3] > 10 * factors[1]

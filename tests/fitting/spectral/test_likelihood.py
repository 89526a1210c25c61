"""Tests of the likelihood of many candidates, its score and its information."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import FloatArray
from imucal.fitting.regressors import WarmUp
from imucal.fitting.spectral import maximum
from imucal.fitting.spectral.likelihood import evaluate
from imucal.fitting.spectral.maximum import _combinations, _mix, find_starts, time_grid
from imucal.fitting.spectral.models import Models, models_of
from imucal.fitting.spectral.ordinates import Ordinates, coarser
from imucal.noise.model import NoiseModel
from tests.fitting.fits import ordinates_of


def ordinates(n: int = 600, text: str = "N=1 + B=0.3 + K=0.05", seed: int = 1) -> Ordinates:
    rng = np.random.default_rng(seed)
    return ordinates_of(NoiseModel.parse(text).simulate(n, rate_hz=1.0, rng=rng))


def rich() -> tuple[Models, FloatArray]:
    """Return three candidates of different structure with parameters away from the maximum."""
    candidates = models_of(
        [("Q", "N", "B", "GM", "GM", "K", "R"), ("N", "GM", "K"), ("N", "B", "R")],
        ("R",),
        poles=[2, 0, 1],
    )
    theta = np.random.default_rng(3).normal(-1.0, 0.5, (3, candidates.width))
    theta[:, 6:8] = np.log([[3.0, 60.0]])
    theta[:, 8:] = [0.7, 0.4]
    return candidates, theta


def test_score_is_the_gradient_of_the_objective() -> None:
    """Central differences of -log L agree for every free parameter of every candidate."""
    data = ordinates()
    candidates, theta = rich()
    score = evaluate(data, candidates, theta).score
    step = 1e-5
    for column in range(candidates.width):
        up, down = theta.copy(), theta.copy()
        up[:, column] += step
        down[:, column] -= step
        numeric = (evaluate(data, candidates, up).objective - evaluate(data, candidates, down).objective) / (
            2 * step
        )
        # Differences of objectives near 1e3 are exact to 1e-13 of them, or 1e-5 of the slope.
        npt.assert_allclose(score[:, column], numeric, rtol=1e-4, atol=1e-4)


def test_information_is_the_expected_curvature() -> None:
    """Where power equals its expectation, the information is the second derivative of -log L."""
    data = ordinates()
    candidates, theta = rich()
    row = candidates[[1]]
    spectrum = evaluate(data, row, theta[[1]]).spectrum[0]
    expected = Ordinates(
        scale=1.0,
        size=data.size,
        power=data.size * spectrum,
        lam=data.lam,
        length=data.length,
        sign=data.sign,
        basis=data.basis,
        regressors=(),
        cross=np.zeros((0, data.size.size)),
        gram=np.zeros((0, 0, data.size.size)),
    )
    plain = replace(row, regressors=np.zeros((1, 0), dtype=bool), names=())
    information = evaluate(expected, plain, theta[[1]]).information[0]
    step = 1e-5
    for column in np.flatnonzero(plain.free[0]):
        up, down = theta[[1]].copy(), theta[[1]].copy()
        up[:, column] += step
        down[:, column] -= step
        numeric = (evaluate(expected, plain, up).score - evaluate(expected, plain, down).score)[0] / (
            2 * step
        )
        npt.assert_allclose(information[column], numeric, rtol=1e-5, atol=1e-5 * information.max())


def dense_objective(samples: FloatArray, white: float, walk: float) -> float:
    """Return -log L of the steps of white noise plus random walk, from their dense covariance."""
    steps = np.diff(samples)
    size = steps.size
    matrix = (2 * white + walk) * np.eye(size) - white * (np.eye(size, k=1) + np.eye(size, k=-1))
    _, logdet = np.linalg.slogdet(matrix)
    return float(0.5 * (logdet + steps @ np.linalg.solve(matrix, steps)))


@pytest.mark.parametrize("walk", [0.0, 1e-4, 0.3, 10.0])
def test_likelihood_of_white_noise_and_random_walk_is_exact(walk: float) -> None:
    """Differences of -log L agree with the dense normal density to rounding."""
    samples = NoiseModel.parse("N=1 + K=0.2").simulate(100, rate_hz=1.0, rng=np.random.default_rng(2))
    data = ordinates_of(samples)
    candidate = models_of([("N", "K")], data.names)

    def fast(white: float, walk: float) -> float:
        theta = np.array([[0.0, np.log(white), 0.0, np.log(walk) if walk else -700.0]])
        return float(evaluate(data, candidate, theta).objective[0])

    difference = fast(1.3, walk) - fast(0.7, 0.1)
    dense = dense_objective(samples, 1.3, walk) - dense_objective(samples, 0.7, 0.1)
    assert difference == pytest.approx(dense, rel=1e-9)


def test_ramp_agrees_with_least_squares() -> None:
    """In white noise, beta is the slope of an ordinary straight-line fit."""
    samples = np.random.default_rng(4).standard_normal(90) + 0.02 * np.arange(90)
    data = ordinates_of(samples)
    candidate = models_of([("N", "R")], data.names)
    found = evaluate(data, candidate, np.zeros((1, 4)))
    assert found.beta[0, 0] == pytest.approx(np.polyfit(np.arange(90), samples, 1)[0], rel=1e-9)
    centred = np.arange(90) - 44.5
    assert found.beta_covariance[0, 0, 0] == pytest.approx(1 / (centred @ centred), rel=1e-9)


def test_a_fixed_ramp_adds_half_its_squared_deviation() -> None:
    """The objective increases by 1/2 if the ramp is fixed one standard error from its estimate."""
    data = ordinates(text="N=1 + R=0.01")
    candidate = models_of([("N", "R")], data.names)
    free = evaluate(data, candidate, np.zeros((1, 4)))
    deviation = np.sqrt(free.beta_covariance[0, 0, 0])
    held = evaluate(data, candidate, np.zeros((1, 4)), ramp=free.beta[:, 0] + deviation)
    assert held.objective[0] - free.objective[0] == pytest.approx(0.5, rel=1e-6)


def test_a_response_that_is_not_positive_has_no_likelihood() -> None:
    """The objective is infinite, so the search avoids such parameters."""
    data = ordinates()
    candidate = models_of([("N",)], data.names, poles=1)
    theta = np.array([[0.0, 0.0, 0.0, 0.0, -1.5]])
    assert evaluate(data, candidate, theta).objective[0] == np.inf


def test_unused_parameters_of_a_candidate_have_no_effect() -> None:
    """A candidate has the same likelihood with extra columns of arbitrary values."""
    data = ordinates()
    own = models_of([("N", "GM")], data.names, poles=1)
    pair = models_of([("N", "GM"), ("N", "GM", "GM")], data.names, poles=1, room_poles=3)
    roomy = pair[[0]]
    narrow = np.array([[0.0, 0.3, 0.0, 0.0, -1.0, 2.0, 0.7]])
    wide = np.array([[5.0, 0.3, 5.0, 5.0, -1.0, 9.0, 2.0, 4.0, 0.7, 3.0, 2.0]])
    one, other = evaluate(data, own, narrow), evaluate(data, roomy, wide)
    assert other.objective[0] == pytest.approx(one.objective[0], rel=1e-12)
    npt.assert_allclose(other.score[0, [1, 4, 6, 8]], one.score[0, [1, 4, 5, 6]], rtol=1e-9)


def test_a_mixture_of_one_spectrum_ends_at_its_mean_ratio() -> None:
    """The weight is the sum of P/S divided by the number of ordinates; exponent 1 needs one round."""
    data = ordinates(text="N=2")
    for law in range(4):
        expected = (data.power / data.basis[law]).sum() / data.size.sum()
        for rounds, exponent in ((50, 0.5), (1, 1.0)):
            weights, objective = _mix(data, data.basis[[law]], np.ones((1, 1)), rounds, exponent)
            assert weights[0, 0] == pytest.approx(expected, rel=1e-6)
        spectrum = expected * data.basis[law]
        terms = np.log(spectrum) * data.size + data.power / spectrum
        assert objective[0] == pytest.approx(terms.sum() / 2)


def test_correlation_times_end_at_a_sixth_of_the_record() -> None:
    """Sixteen times, evenly spaced in log, start at 2 samples or more; a narrow band excludes short times."""
    data = ordinates()
    highest = float(data.fraction.max())
    times = time_grid(data, 10.0)
    assert (times.size, times[-1]) == (16, pytest.approx(100.0))
    assert times[0] == pytest.approx(10 / highest**0.5)
    assert time_grid(data, 0.5)[0] == pytest.approx(2 / highest**0.5)
    assert time_grid(data, 80.0)[-1] == pytest.approx(160 / highest**0.5)
    npt.assert_allclose(np.diff(np.log(times)), np.log(times[1] / times[0]))


def test_coarser_bins_are_sums_and_weighted_means_of_the_finer() -> None:
    """The first twelve bins of a block are kept, then six are merged into one; merged bins have no sign."""
    parts = [ordinates(600), ordinates(400, seed=2)]
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts], axis=-1)
        for name in ("size", "power", "lam", "length", "sign", "basis", "cross", "gram")
    }
    data = replace(parts[0], **joined)
    found = coarser(data)
    groups, start = [], 0
    for part in parts:
        stop = start + part.size.size
        groups += [[i] for i in range(start, start + 12)]
        groups += [list(range(i, min(i + 6, stop))) for i in range(start + 12, stop, 6)]
        start = stop
    for place, group in enumerate(groups):
        size = data.size[group]
        assert found.size[place] == size.sum()
        assert found.power[place] == pytest.approx(data.power[group].sum())
        assert found.lam[place] == pytest.approx(data.lam[group] @ size / size.sum())
        npt.assert_allclose(found.basis[:, place], data.basis[:, group] @ size / size.sum())
        assert found.cross[0, place] == pytest.approx(data.cross[0, group].sum())
        assert found.sign[place] == (data.sign[group[0]] if len(group) == 1 else 0.0)
    assert found.size.size == len(groups)
    npt.assert_array_equal(np.unique(found.length), [400.0, 600.0])


def test_the_number_of_coarser_bins_does_not_grow_with_gaps() -> None:
    """Bins of many blocks are merged by frequency without loss, so gaps do not slow the start down."""
    parts = [ordinates(500, seed=seed) for seed in range(7)]
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts], axis=-1)
        for name in ("size", "power", "lam", "length", "sign", "basis", "cross", "gram")
    }
    data = replace(parts[0], **joined)
    found = coarser(data)
    each = coarser(parts[0]).size.size
    assert found.size.size == -(-7 * each // 4)
    assert np.all(np.diff(found.lam) >= 0)
    assert found.size.sum() == data.size.sum()
    assert found.power.sum() == pytest.approx(data.power.sum())


def test_a_narrower_band_keeps_the_bins_up_to_its_end() -> None:
    """The bin at the end is kept, empty bins are dropped, and `top` is the end of the band."""
    data = ordinates()
    fraction = float(data.fraction[40])
    size = data.size.copy()
    size[3] = 0.0
    found = replace(data, size=size).below(fraction)
    npt.assert_array_equal(found.lam, np.delete(data.lam[:41], 3))
    assert found.top == pytest.approx(4 * np.sin(np.pi * fraction / 2) ** 2)
    assert found.top == pytest.approx(data.lam[40], rel=1e-6)


def test_a_preliminary_ramp_is_removed_from_the_power() -> None:
    """The slope is a least-squares fit with weights lam, and every bin keeps positive power."""
    data = ordinates(text="N=1 + R=0.1")
    slope = (data.cross[0] @ data.lam) / (data.gram[0, 0] @ data.lam)
    rest = data.power - 2 * slope * data.cross[0] + slope**2 * data.gram[0, 0]
    found = data.detrended()
    npt.assert_allclose(found.power, np.maximum(rest, 1e-9 * data.power))
    assert replace(data, regressors=(WarmUp(time_constant=5.0),)).detrended().power is data.power


@pytest.mark.parametrize(("count", "places"), [(3, (0, 8, 15)), (4, (0, 5, 10, 15))])
def test_more_than_two_gauss_markov_terms_start_evenly_over_the_grid(
    count: int, places: tuple[int, ...]
) -> None:
    """They have one start, from the first to the last of 16 times; two terms start at every pair."""
    assert _combinations(count) == [places]
    assert [len(_combinations(few)) for few in range(3)] == [1, 16, 120]


@pytest.mark.parametrize("quick", [False, True])
def test_the_best_starts_are_found_in_the_first_rounds(
    monkeypatch: pytest.MonkeyPatch, *, quick: bool
) -> None:
    """A candidate's best starts after the first rounds include its best after all rounds."""
    text = "N=1 + GM(sigma=0.3, T=20) + GM(sigma=0.2, T=900) + K=3e-4"
    data = coarser(ordinates(n=40_000, text=text, seed=8123), singles=48, merge=3)
    candidates = models_of([("N", "GM", "K"), ("N", "GM", "GM"), ("N", "B", "GM", "GM", "R")], data.names)
    owner, theta = find_starts(data, candidates, keep=(1, 2, 3), quick=quick)
    monkeypatch.setattr(maximum, "_THOROUGH", ((25, 10**6, 1.0) if quick else (50, 10**6, 0.5),))
    every_owner, every_theta = find_starts(data, candidates, keep=(1, 2, 3))
    assert owner.tolist() == every_owner.tolist()
    npt.assert_allclose(theta, every_theta, rtol=1e-9)

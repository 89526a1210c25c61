"""Accelerometer: exact recovery, observability, the diagonal model, which rest to add."""

import math

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.calibration.accelerometer import (
    LOWER,
    PARAMETERS,
    derivatives,
    describe_direction,
    fit_accelerometer,
    suggest_rest,
)
from imucal.errors import DataError
from tests.calibration.simulated import FACES, GRAVITY, Truth, attitudes


def noise(m: int, deviation: float = 1e-3) -> FloatArray:
    return np.tile(deviation**2 * np.eye(m), (3, 1, 1))


def exact(up: FloatArray, truth: Truth) -> FloatArray:
    return np.asarray(up * GRAVITY @ truth.M_a.T + truth.b_a)


@pytest.fixture
def truth() -> Truth:
    return Truth.draw(np.random.default_rng(6200))


def test_recovers_exact_parameters(truth: Truth) -> None:
    """Twelve attitudes without noise."""
    fit = fit_accelerometer(exact(attitudes(12, np.random.default_rng(1)), truth), noise(12), gravity=GRAVITY)
    assert fit.model == "full"
    np.testing.assert_allclose(fit.C, np.linalg.inv(truth.M_a), atol=1e-10)
    np.testing.assert_allclose(fit.b, truth.b_a, atol=1e-9)
    assert fit.dof == 3
    assert fit.chi2 < 1e-10


def test_raw_counts_need_no_scale(truth: Truth) -> None:
    """Offset-binary counts of an unknown scale."""
    means = 415 * exact(attitudes(14, np.random.default_rng(2)), truth) + 32768
    fit = fit_accelerometer(means, noise(14, 0.5), gravity=GRAVITY)
    np.testing.assert_allclose(fit.C * 415, np.linalg.inv(truth.M_a), atol=1e-9)


def test_derivatives_are_those_of_finite_differences(truth: Truth) -> None:
    """Of |f| in the nine parameters and in the raw means."""
    means = exact(attitudes(10, np.random.default_rng(3)), truth)
    C = np.asarray(np.linalg.inv(truth.M_a) + np.tril(np.full((3, 3), 0.01)), dtype=np.float64)
    b = truth.b_a + 0.1
    _, J, weights = derivatives(means, C, b)

    def norm(theta: FloatArray, moved: float = 0.0, axis: int = 0) -> FloatArray:
        matrix = np.zeros((3, 3))
        matrix[LOWER] = theta[:6]
        return derivatives(means + moved * np.eye(3)[axis], matrix, theta[6:])[0]

    theta = np.concatenate([C[LOWER], b])
    for k in range(9):
        step = 1e-6 * np.eye(9)[k]
        np.testing.assert_allclose((norm(theta + step) - norm(theta - step)) / 2e-6, J[:, k], atol=1e-7)
    for a in range(3):
        np.testing.assert_allclose(
            (norm(theta, 1e-6, a) - norm(theta, -1e-6, a)) / 2e-6, weights[:, a], atol=1e-7
        )


def test_six_faces_give_a_diagonal_model(truth: Truth) -> None:
    """Misalignment is not observable; the ignored one widens the intervals enough."""
    hits = []
    for seed in range(40):
        rng = np.random.default_rng(6300 + seed)
        own = Truth.draw(rng)
        fit = fit_accelerometer(exact(attitudes(6, rng), own), noise(6), gravity=GRAVITY)
        assert fit.model == "diagonal"
        error = fit.theta - np.concatenate([np.linalg.inv(own.M_a)[LOWER], own.b_a])
        hits.append((np.abs(error) < 1.96 * np.sqrt(np.diag(fit.covariance)))[fit.free])
    assert np.mean(hits) > 0.9
    fit = fit_accelerometer(exact(FACES, truth), noise(6), gravity=GRAVITY)
    assert [s for p, s in zip(PARAMETERS, fit.statuses, strict=True) if "mis" in p] == ["not-observable"] * 3
    assert fit.statuses[0] == "estimated"


@pytest.mark.parametrize("count", [1, 3, 5])
def test_too_few_faces_cannot_be_calibrated(count: int, truth: Truth) -> None:
    """Each axis needs both directions."""
    with pytest.raises(DataError, match="six faces"):
        fit_accelerometer(exact(FACES[:count], truth), noise(count), gravity=GRAVITY)


def test_repeated_faces_do_not_determine_misalignment(truth: Truth) -> None:
    """Eighteen rests in six attitudes: still diagonal, and `full` is refused."""
    means = exact(np.tile(FACES, (3, 1)), truth)
    assert fit_accelerometer(means, noise(18), gravity=GRAVITY).model == "diagonal"
    with pytest.raises(ValueError, match="nine parameters"):
        fit_accelerometer(means, noise(18), gravity=GRAVITY, model="full")


def test_nearly_repeated_faces_are_weak(truth: Truth) -> None:
    """Tilted by half a degree, faces determine misalignment, but hardly."""
    up = np.tile(FACES, (3, 1)) + np.random.default_rng(5).normal(0, 0.009, (18, 3))
    means = exact(up / np.linalg.norm(up, axis=1)[:, None], truth)
    fit = fit_accelerometer(means, noise(18), gravity=GRAVITY)
    assert fit.model == "full"
    statuses = dict(zip(PARAMETERS, fit.statuses, strict=True))
    assert {statuses[p] for p in PARAMETERS if "mis" in p} == {"weak"}
    assert statuses["bias_x"] == "estimated"


def test_faces_that_are_tilted_by_chance_do_not_make_a_result_worse() -> None:
    """Without the prior, tilts of 0.3° would give misalignments of several degrees from the noise."""
    for seed in range(6330, 6340):
        rng = np.random.default_rng(seed)
        own = Truth.draw(rng)
        up = np.tile(FACES, (2, 1)) + rng.normal(0, 0.004, (12, 3))
        means = exact(up / np.linalg.norm(up, axis=1)[:, None], own) + rng.normal(0, 1e-3, (12, 3))
        fit = fit_accelerometer(means, noise(12), gravity=GRAVITY)
        diagonal = fit_accelerometer(means, noise(12), gravity=GRAVITY, model="diagonal")
        everywhere = exact(attitudes(500, rng, tilt=1.0), own)
        worst, peer = (
            np.abs(np.linalg.norm((everywhere - each.b) @ each.C.T, axis=1) - GRAVITY).max()
            for each in (fit, diagonal)
        )
        assert worst <= 1.1 * peer


def test_a_large_misalignment_is_not_drawn_to_the_prior() -> None:
    """2.5°, 2.9 deviations of the prior, is found to the noise; its interval is that of the rests alone."""
    M = np.eye(3)
    M[1, 0], M[2, 1] = math.tan(math.radians(2.5)), -math.tan(math.radians(2.5))
    own = Truth(M_a=300 * M, b_a=np.array([40.0, -20.0, 7.0]), M_g=np.eye(3), b_g=np.zeros(3), G=np.eye(3))
    means = exact(attitudes(18, np.random.default_rng(6340)), own)
    fit = fit_accelerometer(means, noise(18) * 300**2, gravity=GRAVITY)
    np.testing.assert_allclose(np.linalg.inv(fit.C), own.M_a, rtol=0, atol=1e-4)
    assert not fit.with_prior.any()
    assert set(fit.statuses) == {"estimated"}


def test_unknown_gravity_widens_scales_only(truth: Truth) -> None:
    """0.015 m/s² are 0.15 % of each scale; bias and misalignment hardly change."""
    means = exact(attitudes(18, np.random.default_rng(6)), truth)
    known = fit_accelerometer(means, noise(18), gravity=GRAVITY)
    unknown = fit_accelerometer(means, noise(18), gravity=GRAVITY, gravity_sigma=0.015)
    wide, narrow = (np.sqrt(np.diag(fit.covariance)) for fit in (unknown, known))
    np.testing.assert_allclose(wide[[0, 2, 5]], 0.015 / GRAVITY, rtol=0.05)
    np.testing.assert_allclose(wide[6:], narrow[6:], rtol=0.05)
    assert unknown.statuses == known.statuses


def test_the_suggested_rest_helps_as_predicted(truth: Truth) -> None:
    """No x-z edge, but a face tilted by 10°: the suggestion is an edge, and it helps that much."""
    edges = np.array([[1, 1, 0], [1, -1, 0], [0, 1, 1]]) / np.sqrt(2)
    up = np.vstack([FACES, edges, [[np.sin(0.17), 0, np.cos(0.17)]]])
    fit = fit_accelerometer(exact(up, truth), noise(10), gravity=GRAVITY)
    found = suggest_rest(fit, gravity=GRAVITY)
    assert found.parameter == "misalignment_zx"
    assert {word.strip(",")[1] for word in found.text.split() if word[0] in "+-"} >= {"x", "z"}
    better = fit_accelerometer(
        exact(np.vstack([up, -np.array(found.down)]), truth), noise(11), gravity=GRAVITY
    )
    size = np.array([1.0] * 6 + [1 / GRAVITY] * 3)
    before, after = ((np.sqrt(np.diag(f.covariance)) * size).max() for f in (fit, better))
    assert after / before == pytest.approx(found.ratio, rel=0.05)
    assert found.ratio < 0.5


def test_directions_in_words() -> None:
    """Nearest axis first, with the angle from it."""
    assert describe_direction(np.array([0.0, 0.1, -0.995])) == "down along -z"
    assert describe_direction(np.array([-0.766, 0.0, 0.643])) == "down between -x and +z, 40° from -x"


def test_samples_in_si_stay_near_one_where_rests_on_one_side_show_little() -> None:
    """Ten rests in one half of the sphere: scale and bias have a prior in m/s², and none in counts."""
    worst = []
    for seed in range(6340, 6356):
        rng = np.random.default_rng(seed)
        own = Truth.draw(rng)
        up = rng.normal(size=(10, 3))
        up[:, 2] = np.abs(up[:, 2]) + 0.3
        means = exact(up / np.linalg.norm(up, axis=1)[:, None], own) + rng.normal(0, 1e-3, (10, 3))
        everywhere = exact(attitudes(500, rng, tilt=1.0), own)
        fits = (fit_accelerometer(means, noise(10), gravity=GRAVITY, si=si) for si in (True, False))
        worst.append(
            [np.abs(np.linalg.norm((everywhere - fit.b) @ fit.C.T, axis=1) - GRAVITY).max() for fit in fits]
        )
    known, unknown = np.max(worst, axis=0)
    assert known < 0.7 * unknown


def test_a_prior_does_not_move_what_the_rests_show(truth: Truth) -> None:
    """Eighteen rests: the same values and intervals in m/s² and in other units."""
    means = exact(attitudes(18, np.random.default_rng(12)), truth)
    known, unknown = (fit_accelerometer(means, noise(18), gravity=GRAVITY, si=si) for si in (True, False))
    np.testing.assert_allclose(known.theta, unknown.theta, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(known.covariance, unknown.covariance, rtol=1e-6, atol=1e-18)

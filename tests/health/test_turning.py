"""Tests of the forces that turns explain, against least squares of each part."""

import numpy as np
from scipy.interpolate import CubicSpline

from imucal.arrays import FloatArray
from imucal.health.turning import MODEL_ERROR, PROPER, Turning


def turning(rng: np.random.Generator, parts: int = 3, n: int = 20) -> Turning:
    """Return parts with any rates, forces and weights."""
    return Turning(
        rates=rng.normal(size=(parts, n, 3)),
        forces=rng.normal(size=(parts, n, 3)),
        weights=rng.uniform(0.1, 1.0, (parts, n)),
        times_s=np.tile(np.arange(n) / 60, (parts, 1)),
        step_s=1 / 60,
        force_at=CubicSpline(np.arange(4.0), np.zeros((4, 3))),
    )


def left_by_least_squares(turns: Turning, rates: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return what gravity and lever leave of the forces in a matrix's axes, part by part, shape (b,)."""
    rotated, levers = turns.rotated(rates), turns.levers(rates)
    left = []
    for k, forces in enumerate(turns.forces):
        root = np.repeat(np.sqrt(turns.weights[k]), 3)
        columns = np.concatenate([rotated[k], levers[k]], axis=2).reshape(-1, 6) * root[:, None]
        usual = np.hstack([np.zeros((3, 3)), MODEL_ERROR * np.eye(3)])
        wanted = np.concatenate([(forces @ matrix).ravel() * root, np.zeros(3)])
        left.append(np.linalg.lstsq(np.vstack([columns, usual]), wanted)[1][0])
    return np.array(left)


def test_residuals_are_those_of_least_squares() -> None:
    """For each rotation of the axes, and for a matrix that is none."""
    rng = np.random.default_rng(2212)
    turns = turning(rng)
    matrices = np.concatenate([PROPER, rng.normal(size=(2, 3, 3))])
    found = turns.residuals(turns.design(turns.rates), turns.forces, matrices)
    for column, matrix in zip(found.T, matrices, strict=True):
        np.testing.assert_allclose(column, left_by_least_squares(turns, turns.rates, matrix), rtol=1e-10)


def test_a_turn_without_errors_is_explained_by_its_own_axes_alone() -> None:
    """The forces of a constant gravity in a turning frame leave nothing with the identity."""
    rng = np.random.default_rng(2213)
    turns = turning(rng)
    gravity = turns.rotated(turns.rates) @ np.array([0.6, 0.0, 0.8])
    seen = turns.residuals(turns.design(turns.rates), gravity, PROPER)
    own = [bool(np.allclose(matrix, np.eye(3))) for matrix in PROPER]
    assert np.abs(seen[:, own]).max() < 1e-10
    assert seen[:, ~np.array(own)].min() > 1e-4

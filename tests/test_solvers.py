"""Small solvers, against SciPy's."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest
from scipy.optimize import brentq, minimize, nnls

from imucal.arrays import FloatArray
from imucal.solvers import lowest, non_negative, root


@pytest.mark.parametrize("seed", range(8))
def test_non_negative_least_squares_agree_with_scipy(seed: int) -> None:
    """Few and many columns, of lengths a million apart, some of them alike; some answers are zero."""
    rng = np.random.default_rng([771, seed])
    for _ in range(60):
        k, p = int(rng.integers(2, 25)), int(rng.integers(1, 12))
        matrix = np.abs(rng.standard_normal((k, p))) * 10 ** rng.uniform(-3, 3, p)
        truth = np.maximum(rng.standard_normal(p), 0) / np.linalg.norm(matrix, axis=0)
        target = matrix @ truth + rng.standard_normal(k) * 10 ** rng.uniform(-4, 1)
        found, square = non_negative(matrix, target)
        length = np.linalg.norm(matrix, axis=0)
        expected, rest = nnls(matrix / length, target)
        assert (found >= 0).all()
        assert math.sqrt(square) == pytest.approx(rest, abs=1e-10 * float(np.linalg.norm(target)))
        if p <= k // 2:
            npt.assert_allclose(found * length, expected, atol=1e-8 * float(np.linalg.norm(target)))


def test_non_negative_least_squares_of_nothing() -> None:
    """No column, and columns of zeros, explain nothing."""
    target = np.array([3.0, 4.0])
    assert non_negative(np.zeros((2, 0)), target)[1] == pytest.approx(25.0)
    found, square = non_negative(np.array([[1.0, 0.0], [0.0, 0.0]]), target)
    assert found.tolist() == pytest.approx([3.0, 0.0])
    assert square == pytest.approx(16.0)
    assert non_negative(np.array([[1.0], [1.0]]), -target)[0].tolist() == [0.0]


@pytest.mark.parametrize(
    ("function", "low", "high"),
    [
        (lambda x: x**3 - 2 * x - 5, 2.0, 3.0),
        (lambda x: math.cos(x) - x, 0.0, 1.0),
        (lambda x: math.exp(-x) - 1e-6, 0.0, 30.0),
        (lambda x: 50.0 if x < -3 else -x, -20.0, 25.0),
        (lambda x: x, -1.0, 1.0),
    ],
)
def test_a_root_agrees_with_scipy(function: Callable[[float], float], low: float, high: float) -> None:
    """Smooth, steep and flat functions; Wallis's own cubic among them."""
    expected = brentq(function, low, high, xtol=1e-13)
    assert root(function, low, high, tolerance=1e-9) == pytest.approx(expected, abs=2e-9)
    assert root(lambda x: -function(x), low, high, tolerance=1e-9) == pytest.approx(expected, abs=2e-9)


def test_a_root_needs_different_signs() -> None:
    """An end that is a root is returned."""
    with pytest.raises(ValueError, match=r"is 1.0 at 0.0 and 4.0 at 1.0, expected different signs"):
        root(lambda x: (x + 1) ** 2, 0.0, 1.0, tolerance=1e-6)
    assert root(lambda x: x - 1, 0.0, 1.0, tolerance=1e-6) == 1.0
    assert root(lambda x: x, 0.0, 1.0, tolerance=1e-6) == 0.0


@pytest.mark.parametrize("size", [1, 2, 5])
def test_the_lowest_place_is_where_scipy_finds_it(size: int) -> None:
    """The same steps of the simplex, digit by digit, from any start."""
    rng = np.random.default_rng([772, size])
    for _ in range(10):
        matrix, start = rng.standard_normal((size, size)), 3 * rng.standard_normal(size)
        start[0] *= rng.integers(2)

        def cost(at: FloatArray, matrix: FloatArray = matrix) -> float:
            return float(np.sum(np.abs(matrix @ at - 1) ** 1.7) + np.sin(at[0]))

        options: dict[str, Any] = {"xatol": 1e-2, "fatol": 0.05, "maxfev": 5000, "maxiter": 5000}
        expected: Any = minimize(cost, start, method="Nelder-Mead", options=options)  # type: ignore[call-overload]
        found, value = lowest(cost, start, near=1e-2, alike=0.05, most=5000)
        npt.assert_allclose(found, expected.x, atol=1e-9)
        assert value == pytest.approx(float(expected.fun), abs=1e-12)


def test_a_search_ends_after_so_many_evaluations() -> None:
    """With the best place of all it saw."""
    seen = []

    def cost(at: FloatArray) -> float:
        seen.append(float(at @ at))
        return seen[-1]

    _, value = lowest(cost, np.array([5.0, 7.0]), near=0.0, alike=0.0, most=20)
    assert 20 <= len(seen) <= 24
    assert value == min(seen)

"""Tests of small solvers, compared with SciPy's."""

import math
from collections.abc import Callable

import numpy as np
import numpy.testing as npt
import pytest
from scipy.optimize import brentq, nnls

from imucal.solvers import non_negative, root, root_near


@pytest.mark.parametrize("seed", range(8))
def test_non_negative_least_squares_agree_with_scipy(seed: int) -> None:
    """There are few and many columns with lengths up to 1e6 apart; some solutions are zero."""
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


def test_non_negative_least_squares_without_columns() -> None:
    """Columns of zeros explain nothing either."""
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
    """The functions are smooth, steep or flat; one is Wallis's cubic."""
    expected = brentq(function, low, high, xtol=1e-13)
    assert root(function, low, high, tolerance=1e-9) == pytest.approx(expected, abs=2e-9)
    assert root(lambda x: -function(x), low, high, tolerance=1e-9) == pytest.approx(expected, abs=2e-9)


@pytest.mark.parametrize("start", [-4.0, 1.0, 9.0])
def test_secants_find_the_root_of_a_falling_function(start: float) -> None:
    """Straight, curved and kinked functions need fewer evaluations than a bracket of that width."""
    functions: list[Callable[[float], float]] = [
        lambda x: 3 - 0.5 * x,
        lambda x: 2 - 0.5 * x - 0.1 * math.sin(x),
        lambda x: 1 - 0.4 * x - 0.3 * max(x - 1, 0.0),
    ]
    for function in functions:
        places: list[float] = []

        def counted(
            x: float, function: Callable[[float], float] = function, seen: list[float] = places
        ) -> float:
            seen.append(x)
            return function(x)

        found = root_near(counted, start, -0.5, low=-30.0, high=30.0, tolerance=1e-9)
        assert found == pytest.approx(brentq(function, -30.0, 30.0, xtol=1e-13), abs=2e-9)
        assert len(places) < 13


def test_secants_return_none_without_a_root() -> None:
    """The function has its root outside the bracket, rises, or jumps."""
    assert root_near(lambda x: 40 - x, 0.0, -1.0, low=-5.0, high=5.0, tolerance=1e-9) is None
    assert root_near(lambda x: x, 1.0, -0.5, low=-5.0, high=5.0, tolerance=1e-9) is None
    assert root_near(lambda x: 1.0 if x < 1 else -1.0, 0.0, -0.5, low=-5.0, high=5.0, tolerance=1e-9) is None
    assert root_near(lambda x: -x, 0.0, -0.5, low=-5.0, high=5.0, tolerance=1e-9) == 0.0


def test_a_root_needs_different_signs() -> None:
    """An end that is a root is returned."""
    with pytest.raises(ValueError, match=r"is 1.0 at 0.0 and 4.0 at 1.0, expected different signs"):
        root(lambda x: (x + 1) ** 2, 0.0, 1.0, tolerance=1e-6)
    assert root(lambda x: x - 1, 0.0, 1.0, tolerance=1e-6) == 1.0
    assert root(lambda x: x, 0.0, 1.0, tolerance=1e-6) == 0.0

"""Tests of least squares without negative solutions, compared with the best of all subsets of columns."""

from itertools import combinations

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan.least_squares import non_negative
from imucal.arrays import FloatArray


def slow(matrix: FloatArray, target: FloatArray) -> tuple[FloatArray, float]:
    """Return the best solution among those of every subset of columns that are not negative."""
    columns = matrix.shape[1]
    best, least = np.zeros(columns), float(target @ target)
    for count in range(1, columns + 1):
        for used in map(list, combinations(range(columns), count)):
            solution = np.linalg.lstsq(matrix[:, used], target, rcond=None)[0]
            rest = matrix[:, used] @ solution - target
            if solution.min() >= 0 and rest @ rest < least:
                best, least = np.zeros(columns), float(rest @ rest)
                best[used] = solution
    return best, least


@pytest.mark.parametrize("seed", range(4))
def test_the_solution_is_the_best_of_all_subsets(seed: int) -> None:
    """Lengths of columns differ by up to 1e6, as those of noise terms do."""
    rng = np.random.default_rng([772, seed])
    for _ in range(20):
        rows, columns = int(rng.integers(5, 25)), int(rng.integers(1, 6))
        size = 10 ** rng.uniform(-3, 3, columns)
        matrix = np.abs(rng.standard_normal((rows, columns)))
        target = matrix @ rng.standard_normal(columns) + rng.standard_normal(rows)
        expected, square = slow(matrix, target)
        found, least = non_negative(matrix * size, target)
        npt.assert_allclose(found * size, expected, atol=1e-8 * float(np.linalg.norm(target)))
        assert least == pytest.approx(square, rel=1e-9)


def test_a_column_of_zeros_explains_nothing() -> None:
    """Neither do columns that point away from the target, or no columns."""
    target = np.array([3.0, 4.0])
    found, square = non_negative(np.array([[1.0, 0.0], [0.0, 0.0]]), target)
    assert found.tolist() == pytest.approx([3.0, 0.0])
    assert square == pytest.approx(16.0)
    assert non_negative(np.array([[1.0], [1.0]]), -target)[0].tolist() == [0.0]
    assert non_negative(np.zeros((2, 0)), target)[1] == pytest.approx(25.0)

"""Tests of order statistics that equal NumPy's without its imports."""

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest

from imucal.arrays import aligned, distinct, median, percentile


@pytest.mark.parametrize("n", [1, 2, 3, 10, 101, 1000])
def test_medians_and_percentiles_equal_numpys(n: int) -> None:
    rng = np.random.default_rng([770, n])
    for values in (rng.standard_normal(n), rng.integers(0, 10**9, n), rng.integers(0, 3, n).astype(float)):
        assert median(values) == np.median(values)
        for percent in (0, 10, 33.3, 50, 75, 90, 95, 100):
            assert percentile(values, percent) == np.percentile(values, percent)


@pytest.mark.parametrize("n", [0, 1, 2, 10, 1000])
def test_distinct_numbers_equal_numpys(n: int) -> None:
    values = np.random.default_rng([771, n]).integers(-20, 20, n)
    assert distinct(values).tolist() == np.unique(values).tolist()


def test_a_list_has_a_median() -> None:
    assert median([4, 1, 2, 8]) == 3.0


def test_masked_arrays_are_not_imported() -> None:
    text = "import sys, numpy; from imucal.arrays import *; import imucal.arrays as a; x = numpy.arange(9.0)"
    text += "; a.median(x); a.percentile(x, 10); a.distinct(x); print('numpy.ma' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stdout.split() == ["False"]


@pytest.mark.parametrize("n", [1, 7, 1000, 100_000])
def test_an_aligned_array_begins_at_a_cache_line(n: int) -> None:
    arrays = [aligned(n) for _ in range(5)]
    for array in arrays:
        assert array.shape == (n,)
        assert array.dtype == np.float64
        assert array.flags.writeable
        assert array.flags.c_contiguous
        assert array.__array_interface__["data"][0] % 64 == 0
        array[:] = 1.0
    for first, second in pairwise(arrays):
        assert not np.shares_memory(first, second)

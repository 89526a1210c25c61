"""Tests of the DCT-II of long records, computed from many short transforms."""

import tracemalloc

import numpy as np
import numpy.testing as npt
import pytest
from scipy.fft import dct

from imucal.allan.dct import LONG, dct2, dct_ordinates, four_step_dct, four_step_idct, idct2, split


@pytest.mark.parametrize("n", [2, 3, 4, 5, 6, 7, 12, 15, 16, 36, 49, 97, 1000, 1001, 65_537, 120_000])
def test_ordinates_agree_with_scipy(n: int) -> None:
    """Lengths have odd and even factors, squares and primes."""
    samples = np.random.default_rng(1300 + n).standard_normal(n) + 3.0
    found, witness = four_step_dct(samples, 3.0), dct(samples - 3.0, norm="ortho")
    npt.assert_allclose(found, witness, rtol=0, atol=1e-14 * np.abs(witness).max())


@pytest.mark.parametrize("n", [2, 3, 4, 5, 6, 7, 12, 15, 16, 36, 49, 97, 1000, 1001, 65_537, 120_000])
def test_the_inverse_returns_the_samples(n: int) -> None:
    """The ordinate of the mean is included, so the inverse restores the offset of 3."""
    samples = np.random.default_rng(1400 + n).standard_normal(n) + 3.0
    found = four_step_idct(dct(samples, norm="ortho"))
    npt.assert_allclose(found, samples, rtol=0, atol=1e-14 * np.abs(samples).max())


@pytest.mark.parametrize("n", [LONG - 1, LONG])
def test_transform_and_inverse_are_consistent(n: int) -> None:
    """The faster of two algorithms depends on the length."""
    samples = np.random.default_rng(1304).standard_normal(n)
    npt.assert_allclose(idct2(dct2(samples, 1.0)) + 1.0, samples, rtol=0, atol=1e-13)


@pytest.mark.parametrize("n", [LONG, 600_600, 1 << 20])
def test_ordinates_of_a_long_random_walk_agree_with_scipy(n: int) -> None:
    """They span five orders of magnitude; errors are at most 1e-13 of the largest."""
    samples = np.cumsum(np.random.default_rng(1301).standard_normal(n))
    witness = dct(samples - samples.mean(), norm="ortho")[1:]
    npt.assert_allclose(dct_ordinates(samples), witness, rtol=0, atol=1e-13 * np.abs(witness).max())


def test_the_samples_are_not_modified() -> None:
    """They may be read-only or strided."""
    held = np.random.default_rng(1302).standard_normal(2 * 5040)
    kept = held.copy()
    held.flags.writeable = False
    npt.assert_allclose(four_step_dct(held[::2], 0.0), dct(kept[::2], norm="ortho"), atol=1e-12)
    npt.assert_array_equal(held, kept)


def test_the_transform_is_orthonormal() -> None:
    """The sum of squares is preserved (Parseval)."""
    samples = np.random.default_rng(1303).standard_normal(30_030)
    assert np.sum(four_step_dct(samples, 0.0) ** 2) == pytest.approx(np.sum(samples**2), rel=1e-13)


@pytest.mark.parametrize(("n", "factor"), [(1, 1), (97, 1), (100, 10), (10**6, 400), (10**7, 1000)])
def test_one_factor_is_about_the_square_root(n: int, factor: int) -> None:
    """It is slightly smaller, so that rows are longer than columns."""
    assert split(n) == factor


def test_the_transform_needs_sixteen_bytes_per_sample() -> None:
    """They are for the result and the column transforms; all other work is in small pieces."""
    samples = np.random.default_rng(3).standard_normal(1 << 21)
    tracemalloc.start()
    try:
        four_step_dct(samples, 0.0)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak / samples.size < 19

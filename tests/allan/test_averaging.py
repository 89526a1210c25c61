"""Tests of averaging factors: sets, lists and errors."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan.engine import averaging_factors
from imucal.arrays import IntArray
from imucal.errors import DataError


def _factors(taus: str | list[float], n: int = 1000) -> IntArray:
    return averaging_factors(taus, tau0=0.01, largest=n // 2, drawn=max(n // 4, 1), name="gyro_x")


def test_octaves_stop_at_a_quarter_of_the_record() -> None:
    """Factors are 1, 2, 4 … up to m <= n/4."""
    npt.assert_array_equal(_factors("octave"), [1, 2, 4, 8, 16, 32, 64, 128])
    npt.assert_array_equal(_factors("octave", 1024), 2 ** np.arange(9))
    npt.assert_array_equal(_factors("octave", 2), [1])


def test_decades_are_even_in_log_and_distinct() -> None:
    """There are ten per decade by default, rounded to integers without duplicates."""
    npt.assert_array_equal(_factors("decade", 40), [1, 2, 3, 4, 5, 6, 8, 10])
    twenty = _factors("decade:20", 4_000_000)
    assert twenty[-1] == 1_000_000
    assert np.all(np.diff(twenty) > 0)
    large = twenty[twenty > 100].astype(np.float64)
    npt.assert_allclose(np.diff(np.log10(large)), 1 / 20, atol=5e-3)


def test_all_goes_up_to_half_of_the_record() -> None:
    npt.assert_array_equal(_factors("all", 10), [1, 2, 3, 4, 5])


def test_seconds_are_rounded_to_samples() -> None:
    """Times that round to the same factor give one value."""
    npt.assert_array_equal(_factors([1.0, 0.01, 0.0104, 5.0]), [1, 100, 500])


@pytest.mark.parametrize("taus", ["", "octaves", "decade:", "decade:0", "decade:-3", "1,2"])
def test_an_unknown_set_is_rejected(taus: str) -> None:
    """The error lists the valid sets."""
    with pytest.raises(ValueError, match="expected 'octave'"):
        _factors(taus)


@pytest.mark.parametrize("taus", [[], [0.0], [-1.0], [float("nan")], [float("inf")]])
def test_a_list_without_positive_seconds_is_rejected(taus: list[float]) -> None:
    """Averaging times are positive and finite, and there is at least one."""
    with pytest.raises(ValueError, match="averaging times must be a list of positive seconds"):
        _factors(taus)


@pytest.mark.parametrize("tau", [0.004, 5.01])
def test_an_unsupported_time_is_rejected(tau: float) -> None:
    """It is shorter than a sample or longer than half the series."""
    with pytest.raises(DataError) as caught:
        _factors([1.0, tau])
    assert str(caught.value) == (
        f"gyro_x: the averaging time {tau:g} s is out of reach: the samples support 0.01 s to 5 s; "
        "leave it out or record longer"
    )

"""Averaging factors: sets, lists, refusals."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan.engine import averaging_factors
from imucal.arrays import IntArray
from imucal.errors import DataError


def _factors(taus: str | list[float], n: int = 1000) -> IntArray:
    return averaging_factors(taus, tau0=0.01, largest=n // 2, drawn=max(n // 4, 1), name="gyro_x")


def test_octaves_stop_at_a_quarter() -> None:
    """1, 2, 4 … up to m <= n/4."""
    npt.assert_array_equal(_factors("octave"), [1, 2, 4, 8, 16, 32, 64, 128])
    npt.assert_array_equal(_factors("octave", 1024), 2 ** np.arange(9))
    npt.assert_array_equal(_factors("octave", 2), [1])


def test_decades_are_even_in_log_and_distinct() -> None:
    """Ten a decade by default, rounded to integers, each once."""
    npt.assert_array_equal(_factors("decade", 40), [1, 2, 3, 4, 5, 6, 8, 10])
    twenty = _factors("decade:20", 4_000_000)
    assert twenty[-1] == 1_000_000
    assert np.all(np.diff(twenty) > 0)
    large = twenty[twenty > 100].astype(np.float64)
    npt.assert_allclose(np.diff(np.log10(large)), 1 / 20, atol=5e-3)


def test_all_goes_to_one_half() -> None:
    """Every factor that the estimator accepts."""
    npt.assert_array_equal(_factors("all", 10), [1, 2, 3, 4, 5])


def test_seconds_round_to_whole_samples_once_each() -> None:
    """Times that round to the same factor give one value."""
    npt.assert_array_equal(_factors([1.0, 0.01, 0.0104, 5.0]), [1, 100, 500])


@pytest.mark.parametrize("taus", ["", "octaves", "decade:", "decade:0", "decade:-3", "1,2"])
def test_refuses_an_unknown_set(taus: str) -> None:
    """The message says what is understood."""
    with pytest.raises(ValueError, match="expected 'octave', 'decade', 'decade:20', 'all' or a list"):
        _factors(taus)


@pytest.mark.parametrize("taus", [[], [0.0], [-1.0], [float("nan")], [float("inf")]])
def test_refuses_a_list_that_is_not_of_positive_seconds(taus: list[float]) -> None:
    """Averaging times are positive and finite, and there is at least one."""
    with pytest.raises(ValueError, match="averaging times must be a list of positive seconds"):
        _factors(taus)


@pytest.mark.parametrize("tau", [0.004, 5.01])
def test_refuses_a_time_the_samples_can_not_give(tau: float) -> None:
    """Shorter than a sample, or longer than half the series; never a silent zero."""
    with pytest.raises(DataError) as caught:
        _factors([1.0, tau])
    assert str(caught.value) == (
        f"gyro_x: the averaging time {tau:g} s is out of reach: the samples support 0.01 s to 5 s; "
        "leave it out or record longer"
    )

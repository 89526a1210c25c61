"""The streaming cascade: exact where it says so, close elsewhere, whatever the blocks."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import Cascade
from imucal.allan.engine import _Level
from imucal.allan.variance import ESTIMATORS, variances
from imucal.arrays import FloatArray
from imucal.errors import DataError

OVERLAPPING = ESTIMATORS["overlapping"]


def _samples(axes: int, n: int, seed: int = 6) -> FloatArray:
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.standard_normal((axes, n)), axis=1)
    return rng.standard_normal((axes, n)) + 3e-3 * walk + 9.8


def _fed(samples: FloatArray, block: int, per_octave: int = 4) -> Cascade:
    cascade = Cascade(axes=samples.shape[0], per_octave=per_octave)
    for start in range(0, samples.shape[1], block):
        cascade.feed(samples[:, start : start + block])
    return cascade


@pytest.mark.parametrize("block", [1000, 32_768, 200_003])
def test_agrees_with_the_exact_values_within_a_hundredth_of_the_interval(block: int) -> None:
    """Factors below 256 are exact; above, values differ by less than 1 % of the interval's width."""
    samples = _samples(2, 200_003)
    cascade = _fed(samples, block, per_octave=8)
    for axis in (0, 1):
        curve = cascade.curve(axis, rate_hz=100.0)
        exact = variances(samples[axis], curve.m, OVERLAPPING)
        low, high = curve.confidence_interval(0.95)
        assert np.max(np.abs(curve.adev - np.sqrt(exact)) / (high - low)) < 0.01
        small = curve.m < 256
        npt.assert_allclose(curve.avar[small], exact[small], rtol=1e-10)
        assert curve.m[-1] > 200_003 // 5
        assert curve.computed == "cascade"
        npt.assert_allclose(curve.tau, curve.m / 100.0)


def test_the_blocks_do_not_matter() -> None:
    """Fed sample by sample or at once, the same values come out."""
    samples = _samples(1, 3000)
    npt.assert_allclose(
        _fed(samples, 1).curve(0, rate_hz=1.0).avar,
        _fed(samples, 3000).curve(0, rate_hz=1.0).avar,
        rtol=1e-9,
    )


def test_a_curve_in_between_changes_nothing() -> None:
    """A live view may ask at any time."""
    samples = _samples(2, 120_000)
    cascade = Cascade(axes=2, per_octave=2)
    for start in range(0, 120_000, 7000):
        cascade.feed(samples[:, start : start + 7000])
        cascade.curve(1, rate_hz=1.0)
    expected = _fed(samples, 7000, per_octave=2).curve(1, rate_hz=1.0)
    npt.assert_allclose(cascade.curve(1, rate_hz=1.0).avar, expected.avar, rtol=1e-10)


def test_no_difference_spans_a_gap() -> None:
    """A jump at a gap leaves no trace: the value is the mean over the two parts, by their terms."""
    first, second = _samples(1, 5000), _samples(1, 3000, seed=7) + 1e3
    cascade = Cascade(axes=1)
    cascade.feed(first)
    cascade.gap()
    cascade.feed(second)
    curve = cascade.curve(0, rate_hz=1.0)
    assert curve.n == 8000
    small = curve.m[curve.m < 256]
    terms = [np.array([OVERLAPPING.terms(part.size, m) for m in small]) for part in (first, second)]
    values = [variances(part[0], small, OVERLAPPING) for part in (first, second)]
    expected = (terms[0] * values[0] + terms[1] * values[1]) / (terms[0] + terms[1])
    npt.assert_allclose(curve.avar[: small.size], expected, rtol=1e-7)


def test_float32_blocks_are_widened() -> None:
    """Samples of a log in single precision are integrated in double."""
    samples = _samples(1, 4000).astype(np.float32)
    cascade = Cascade(axes=1)
    cascade.feed(samples)  # type: ignore[arg-type]
    exact = variances(samples[0].astype(np.float64), np.array([1, 64]), OVERLAPPING)
    curve = cascade.curve(0, rate_hz=1.0)
    npt.assert_allclose(curve.avar[np.isin(curve.m, [1, 64])], exact, rtol=1e-10)


def test_intervals_count_the_strides() -> None:
    """The degrees of freedom fall with m and stay below the number of independent windows."""
    curve = _fed(_samples(1, 300_000), 50_000, per_octave=1).curve(0, rate_hz=1.0)
    assert np.all(np.diff(curve.edf) < 0)
    assert np.all(curve.edf <= 2 * 300_000 / curve.m)


def test_refuses_what_is_not_finite() -> None:
    """The message says where, and what to do."""
    cascade = Cascade(axes=1)
    cascade.feed(np.ones((1, 10)))
    with pytest.raises(DataError) as caught:
        cascade.feed(np.array([[1.0, np.nan]]))
    assert str(caught.value) == (
        "the samples after number 10 are not all finite; leave those out and call gap()"
    )


def test_refuses_too_few_samples() -> None:
    """One sample has no Allan variance."""
    cascade = Cascade(axes=1)
    cascade.feed(np.ones((1, 1)))
    with pytest.raises(DataError, match="1 samples are too few for an Allan variance"):
        cascade.curve(0, rate_hz=1.0)


def test_refuses_a_wrong_shape_and_wrong_options() -> None:
    """Caller's mistakes are ValueErrors with the expected value."""
    with pytest.raises(ValueError, match=r"samples must have shape \(2, k\), got \(10,\)"):
        Cascade(axes=2).feed(np.ones(10))
    with pytest.raises(ValueError, match="need axes >= 1 and per_octave from 1 to 128, got 0 and 1"):
        Cascade(axes=0)


def test_a_level_keeps_what_its_longest_difference_needs() -> None:
    """Twice the largest factor, however many points have passed; every difference is counted once."""
    level = _Level(np.array([3, 5]), 1, 8)
    for start in range(0, 40, 8):
        assert level.take(np.arange(start, start + 8.0)[None, :] ** 2) == 8
        level.work()
        assert level._kept == min(start + 8, 10)
    assert level.terms.tolist() == [34, 30]
    # The second difference of t² at m is 2 m².
    npt.assert_allclose(level.sums(0), [34 * 18.0**2, 30 * 50.0**2])


def test_two_samples_have_a_variance() -> None:
    """Half the square of their difference; a gap between them leaves none."""
    cascade = _fed(np.array([[1.0, 4.0]]), 2)
    curve = cascade.curve(0, rate_hz=10.0)
    assert (curve.m.tolist(), curve.avar.tolist(), curve.n) == ([1], [4.5], 2)
    apart = Cascade(axes=1)
    apart.feed(np.array([[1.0]]))
    apart.gap()
    apart.feed(np.array([[4.0]]))
    with pytest.raises(DataError, match="2 samples are too few"):
        apart.curve(0, rate_hz=10.0)

"""Tests of DCT-II ordinates and their bins."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import dct as dct_module
from imucal.allan.dct import (
    bin_power,
    dct_bins,
    dct_ordinates,
    fast_length,
    own_ordinates,
    ramp_ordinates,
    shared_number,
    shared_transform,
)
from imucal.arrays import FloatArray
from imucal.errors import DataError


@pytest.mark.parametrize("n", [2, 3, 129, 130, 5000, 100_003])
def test_bins_contain_every_ordinate_once(n: int) -> None:
    """Bins are contiguous from 1 to n-1, and their frequency is the mean over their ordinates."""
    bins = dct_bins(n)
    assert bins.first[0] == 1
    npt.assert_array_equal(bins.first[1:], bins.first[:-1] + bins.count[:-1])
    assert bins.first[-1] + bins.count[-1] == n
    ordinate = np.pi * np.arange(1, n) / n
    npt.assert_allclose(bins.omega, np.add.reduceat(ordinate, bins.first - 1) / bins.count)
    assert bins.size == bins.first.size


def test_bins_widen_steadily() -> None:
    """The first 128 bins are single ordinates; above, 48 bins cover an octave."""
    bins = dct_bins(1_000_000)
    npt.assert_array_equal(bins.first[:129], np.arange(1, 130))
    octave = (bins.first >= 10_000) & (bins.first < 20_000)
    assert abs(int(octave.sum()) - 48) <= 1


def test_bins_begin_at_powers_of_their_ratio() -> None:
    """After four single ordinates there are two bins per octave: 5 times powers of sqrt(2)."""
    bins = dct_bins(41, singles=4, per_octave=2)
    npt.assert_array_equal(bins.first, [1, 2, 3, 4, 5, 7, 10, 14, 20, 28, 40])
    npt.assert_array_equal(bins.count, [1, 1, 1, 1, 2, 3, 4, 6, 8, 12, 1])


def test_ordinates_agree_with_their_definition() -> None:
    """X_k = sqrt(2/n) sum y_t cos(pi k (t + 1/2) / n); the mean does not matter."""
    rng = np.random.default_rng(0)
    samples = rng.standard_normal(50) + 1e6
    t, k = np.arange(50), np.arange(1, 50)
    expected = np.sqrt(2 / 50) * np.cos(np.pi * np.outer(k, t + 0.5) / 50) @ (samples - 1e6)
    npt.assert_allclose(dct_ordinates(samples), expected, atol=1e-9)


def test_the_total_power_is_n_times_the_variance() -> None:
    """Parseval's theorem."""
    samples = np.random.default_rng(1).standard_normal(3001)
    power = bin_power(dct_ordinates(samples), dct_bins(3001))
    assert power.sum() == pytest.approx(3001 * samples.var(), rel=1e-12)


def test_invalid_samples_and_bins_are_rejected() -> None:
    """Errors are too few or non-finite samples, and shapes that do not match."""
    with pytest.raises(DataError, match="the spectrum needs at least 2 samples, got 1"):
        dct_ordinates(np.ones(1))
    with pytest.raises(DataError, match="needs finite samples; got NaN or infinity"):
        dct_ordinates(np.array([1.0, np.nan, 2.0]))
    with pytest.raises(ValueError, match=r"ordinates must have shape \(9,\), got \(5,\)"):
        bin_power(np.ones(5), dct_bins(10))
    with pytest.raises(ValueError, match="need n >= 2"):
        dct_bins(1)


@pytest.mark.parametrize("n", [65_537, 131_101, 720_001, 1_000_003, 2_159_999, 9_999_991])
def test_fast_lengths_are_smooth_and_near(n: int) -> None:
    """At most 1e-4 of the samples is omitted, and no prime factor exceeds 127."""
    length = fast_length(n)
    assert 0 <= n - length <= 1e-4 * n
    rest = length
    for factor in range(2, 128):
        while rest % factor == 0:
            rest //= factor
    assert rest == 1 or length == n
    assert n < 700_000 or rest == 1


def test_short_and_smooth_lengths_are_not_reduced() -> None:
    """All lengths below 65536 are fast."""
    lengths = (1, 2, 13, 997, 65_521, 65_536, 1_000_000, 2_160_000)
    assert [fast_length(n) for n in lengths] == list(lengths)


@pytest.mark.parametrize("sizes", [(1, 1, 1), (2, 0, 1), (2, 1, 0)])
def test_too_small_sizes_of_bins_are_rejected(sizes: tuple[int, int, int]) -> None:
    """Two samples, one single ordinate and one bin per octave are the minimum."""
    assert dct_bins(2, singles=1, per_octave=1).count.tolist() == [1]
    n, singles, per_octave = sizes
    with pytest.raises(ValueError, match=f"got {n}, {singles}, {per_octave}"):
        dct_bins(n, singles=singles, per_octave=per_octave)


def test_a_shared_transform_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of more than half of the samples are transformed once, shorter runs and copies each time."""
    samples = np.random.default_rng(77).standard_normal(1000)
    expected = dct_ordinates(samples[:900])
    made: list[int] = []
    plain = dct_module._transform

    def counted(run: FloatArray) -> FloatArray:
        made.append(run.size)
        return plain(run)

    monkeypatch.setattr(dct_module, "_transform", counted)
    with shared_transform(samples):
        for run in (samples[:900], samples[:900], samples[100:], samples[:400], samples[:400]):
            npt.assert_array_equal(dct_ordinates(run), plain(run))
        npt.assert_array_equal(dct_ordinates(samples[:900]), expected)
        assert made == [900, 900, 400, 400]
        npt.assert_array_equal(dct_ordinates(2 * samples), plain(2 * samples))
        assert made.pop() == 1000
    dct_ordinates(samples[:900])
    assert made == [900, 900, 400, 400, 900]


def test_a_shared_number_is_computed_once() -> None:
    """Only the shared samples count; numbers of copies and parts are computed each time."""
    samples, calls = np.arange(100.0), []

    def work() -> float:
        calls.append(1)
        return float(len(calls))

    assert [shared_number(samples, "n", work) for _ in range(2)] == [1.0, 2.0]
    with shared_transform(samples):
        assert [shared_number(samples, "n", work) for _ in range(2)] == [3.0, 3.0]
        assert shared_number(samples, "other", work) == 4.0
        assert [shared_number(samples[1:], "n", work) for _ in range(2)] == [5.0, 6.0]
        assert shared_number(samples.copy(), "n", work) == 7.0
    assert shared_number(samples, "n", work) == 8.0


def test_a_shared_transform_can_be_owned(monkeypatch: pytest.MonkeyPatch) -> None:
    """The owner may write to it, and the next caller gets a new one; shared ones are read-only."""
    samples = np.random.default_rng(78).standard_normal(500)
    made: list[int] = []
    plain = dct_module._transform

    def counted(run: FloatArray) -> FloatArray:
        made.append(run.size)
        return plain(run)

    monkeypatch.setattr(dct_module, "_transform", counted)
    with shared_transform(samples):
        assert not dct_ordinates(samples).flags.writeable
        with shared_transform(samples):
            own = own_ordinates(samples)
        own *= 0.0
        assert made == [500]
        npt.assert_array_equal(dct_ordinates(samples), plain(samples))
        assert made == [500, 500]
        with shared_transform(2 * samples):
            dct_ordinates(samples)
        dct_ordinates(samples)
        assert made == [500] * 4
    npt.assert_array_equal(own_ordinates(samples), plain(samples))


@pytest.mark.parametrize("n", [2, 3, 64, 501, 8193, 30_000])
@pytest.mark.parametrize("first", [1, 2, 7, 250])
def test_a_ramp_agrees_with_its_closed_form_in_parts(n: int, first: int) -> None:
    """A start at any ordinate is exact to the last digits, although few sines are computed."""
    k = np.arange(1, n)
    half = np.pi / (2 * n) * k
    closed = np.where(k % 2 == 1, -np.sqrt(2 / n) * np.cos(half) / (2 * np.sin(half) ** 2), 0.0)
    size = np.abs(closed).max()
    npt.assert_allclose(ramp_ordinates(n, n - 1), closed, rtol=1e-12, atol=1e-16 * size)
    count = max(n - first, 0)
    npt.assert_allclose(
        ramp_ordinates(n, count, first=first), closed[first - 1 :], rtol=1e-12, atol=1e-16 * size
    )


def test_parts_of_bins_contain_every_ordinate_once() -> None:
    """Parts are in order and have the starts of their bins."""
    bins = dct_bins(500_000)
    for here, seen, starts in bins.parts():
        npt.assert_array_equal(bins.first[here] - 1, seen.start + starts)
    runs = [(here, seen) for here, seen, _ in bins.parts()]
    assert len(runs) > 3
    for edges in zip(*runs, strict=True):
        assert [a.stop for a in edges[:-1]] == [b.start for b in edges[1:]]
    assert runs[0][1].start == 0
    assert runs[-1] == (slice(runs[-1][0].start, bins.size), slice(runs[-1][1].start, bins.n - 1))

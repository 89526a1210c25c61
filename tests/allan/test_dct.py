"""Tests of DCT-II ordinates and their bins."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan import allan_curve
from imucal.allan import dct as dct_module
from imucal.allan.dct import (
    Transform,
    bin_power,
    dct_bins,
    dct_ordinates,
    fast_length,
    ramp_ordinates,
    spectrum,
)
from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError
from imucal.fitting import FitSettings, fit_axis
from imucal.recording import AxisSeries


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


def series_of(n: int, *, missing: tuple[int, ...] = ()) -> AxisSeries:
    samples = np.random.default_rng(77).standard_normal(n)
    samples[list(missing)] = np.nan
    return AxisSeries.from_samples(samples, rate_hz=10.0).finite()


@pytest.mark.parametrize(
    ("missing", "start", "size"), [((), 0, 3000), ((100,), 100, 2899), ((1000, 2500), 1000, 1499)]
)
def test_a_transform_is_of_the_longest_run(missing: tuple[int, ...], start: int, size: int) -> None:
    """Samples that were left out do not count as places."""
    series = series_of(3000, missing=missing)
    transform = Transform.of(series)
    assert transform is not None
    assert (transform.n, transform.start, transform.ordinates.size) == (series.n, start, size - 1)
    assert not transform.ordinates.flags.writeable
    npt.assert_array_equal(transform.ordinates, dct_ordinates(series.samples[start : start + size]))


def test_a_series_without_neighbours_has_no_transform() -> None:
    assert Transform.of(series_of(3, missing=(1,))) is None


@pytest.mark.parametrize("missing", [(), (100,), (1000, 2500)])
def test_results_with_and_without_a_transform_are_equal(missing: tuple[int, ...]) -> None:
    """To all digits."""
    series = series_of(3000, missing=missing)
    transform = Transform.of(series)
    npt.assert_array_equal(allan_curve(series, transform=transform).edf, allan_curve(series).edf)
    npt.assert_array_equal(spectrum(series, transform=transform).psd, spectrum(series).psd)
    curve = allan_curve(series)
    plain = fit_axis(series, FitSettings(), curve=curve)
    quick = fit_axis(series, FitSettings(), curve=curve, transform=transform)
    assert plain["N"] == quick["N"]
    npt.assert_array_equal(plain.curve.edf, quick.curve.edf)


def test_the_samples_are_transformed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The curve, the spectrum and the fit use the transform."""
    series = series_of(3000)
    transform = Transform.of(series)
    sizes: list[int] = []
    plain = dct_module.dct2

    def counted(samples: FloatArray, mean: float = 0.0) -> FloatArray:
        sizes.append(samples.size)
        return plain(samples, mean)

    monkeypatch.setattr(dct_module, "dct2", counted)
    curve = allan_curve(series, transform=transform)
    spectrum(series, transform=transform)
    fit_axis(series, FitSettings(), curve=curve, transform=transform)
    assert series.n not in sizes
    fit_axis(series, FitSettings())
    assert sizes.count(series.n) == 1


def test_the_transform_of_another_axis_is_refused() -> None:
    """Only the number of samples is compared."""
    with pytest.raises(ArgumentError, match="500 samples, the axis has 3000"):
        spectrum(series_of(3000), transform=Transform.of(series_of(500)))


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

"""Tests of the search for spectral lines."""

import numpy as np
import pytest

from imucal.allan.dct import DctBins, dct_bins, dct_ordinates
from imucal.arrays import BoolArray, FloatArray
from imucal.fitting.noise_fit import Line
from imucal.fitting.spectral.disturbances.lines import _level, find_lines, with_sines, without_strong_lines
from imucal.noise.model import NoiseModel

N = 60_000


def noise(seed: int) -> np.typing.NDArray[np.float64]:
    return NoiseModel.parse("N=1 + K=3e-3").simulate(N, rate_hz=1.0, rng=np.random.default_rng(seed))


@pytest.mark.parametrize(("place", "amplitude"), [(0.0123, 0.2), (0.2, 0.1), (0.4321, 1.0)])
def test_frequency_and_amplitude_are_found(place: float, amplitude: float) -> None:
    """The strongest line is the added sine; its amplitude is right to 10 %."""
    samples = noise(1) + amplitude * np.sin(2 * np.pi * place * np.arange(N) + 0.4)
    kept, lines = find_lines(dct_ordinates(samples), dct_bins(N), scale=2.0, rate_hz=100.0)
    assert kept is not None
    assert lines[0].frequency_hz == pytest.approx(100 * place, abs=100 / N)
    assert lines[0].amplitude == pytest.approx(2 * amplitude, rel=0.1)


@pytest.mark.parametrize("edge", ["first", "last"])
def test_a_single_ordinate_is_omitted_with_its_neighbours(edge: str) -> None:
    """The line is at the first or last ordinate of a bin; X_k is exactly at k/(2 N) of the rate."""
    bins = dct_bins(N)
    at = int(np.searchsorted(bins.first, 5000))
    k = int(bins.first[at]) if edge == "first" else int(bins.first[at] + bins.count[at] - 1)
    assert bins.count[at] > 1
    ordinates = np.random.default_rng(3).standard_normal(N - 1)
    ordinates[k - 1] = 1000.0
    kept, (line,) = find_lines(ordinates, bins, scale=1.0, rate_hz=100.0)
    assert kept is not None
    assert line.frequency_hz == pytest.approx(100 * k / (2 * N), rel=1e-12)
    assert line.amplitude == pytest.approx(1000 * np.sqrt(2 / N), rel=1e-3)
    # The tail of such a strong line is longer than the permitted 2 % of its frequency.
    reach = int(0.02 * (k - 1))
    assert np.flatnonzero(~kept).tolist() == list(range(k - 1 - reach, k + reach))


@pytest.mark.parametrize(("k", "first"), [(48, None), (49, 49), (51, 49), (60, 57)])
def test_the_lowest_48_ordinates_are_kept(k: int, first: int | None) -> None:
    """A line may start at the 49th ordinate, and its left neighbours below are kept."""
    ordinates = np.random.default_rng(4).standard_normal(N - 1)
    ordinates[k - 1] = 1000.0
    kept, lines = find_lines(ordinates, dct_bins(N), scale=1.0, rate_hz=1.0)
    if first is None:
        assert (kept, lines) == (None, ())
    else:
        assert kept is not None
        assert (np.flatnonzero(~kept) + 1).tolist() == list(range(first, k + 4))


def test_noise_has_no_lines() -> None:
    """The false alarm rate is 1 % per record, so at most 2 of 30 records may have one."""
    found = [find_lines(dct_ordinates(noise(s)), dct_bins(N), scale=1.0, rate_hz=1.0)[0] for s in range(30)]
    assert sum(kept is not None for kept in found) <= 2


def test_a_strong_drift_is_not_a_line() -> None:
    samples = noise(2) + 1e-2 * np.arange(N)
    kept, _ = find_lines(dct_ordinates(samples), dct_bins(N), scale=1.0, rate_hz=1.0)
    assert kept is None or kept[:48].all()


def _level_of(
    square: FloatArray, bins: DctBins, kept: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the level near each bin and its precision, from the kept squares."""
    weight = np.ones(square.size) if kept is None else kept.astype(np.float64)
    starts = bins.first - 1
    return _level(np.add.reduceat(square * weight, starts), np.add.reduceat(weight, starts), bins)


def test_the_precision_of_the_level_is_half_its_number_of_ordinates() -> None:
    """The level uses 17 adjacent bins: single ordinates at first, more than a hundred at the end."""
    bins = dct_bins(1000)
    level, sureness = _level_of(np.ones(999), bins)
    assert sureness[:100].tolist() == [8.5] * 100
    assert sureness[-20] == 0.5 * bins.count[-28:-11].sum() > 40
    assert level[-20] == pytest.approx(1.0)
    # If no ordinate is kept, the level has one degree of freedom.
    assert _level_of(np.ones(999), bins, np.arange(999) < 1)[1][-1] == 1.0


def test_the_level_uses_the_kept_ordinates_only() -> None:
    """With half of the ordinates omitted, the level stays the same and its precision is halved."""
    bins = dct_bins(1000)
    whole, sureness = _level_of(np.full(999, 4.0), bins)
    level, less = _level_of(np.where(np.arange(999) % 2, 4.0, 1e9), bins, np.arange(999) % 2 == 1)
    assert level[-20] == pytest.approx(whole[-20]) == pytest.approx(4.0)
    assert less[-20] == pytest.approx(sureness[-20] / 2, rel=0.05)


@pytest.mark.parametrize("seed", [71, 72, 73])
def test_a_wandering_line_is_omitted(seed: int) -> None:
    """The power of a beat or a fan is spread over more ordinates than a line's nearest neighbours."""
    rng = np.random.default_rng(seed)
    n = 400_000
    omega = 0.2 * (1 + 1e-2 * np.cumsum(rng.standard_normal(n)) / np.sqrt(n))
    samples = rng.standard_normal(n) + np.sin(np.cumsum(omega))
    kept, lines = find_lines(dct_ordinates(samples), dct_bins(n), scale=1.0, rate_hz=1.0)
    assert kept is not None
    assert lines[0].frequency_hz == pytest.approx(0.2 / (2 * np.pi), rel=0.02)
    place = n * 0.2 / np.pi
    left = dct_ordinates(samples)[int(0.96 * place) : int(1.04 * place)]
    assert np.mean(left[kept[int(0.96 * place) : int(1.04 * place)]] ** 2) < 1.5


@pytest.mark.parametrize("name", ["mean of 8", "Butterworth 2", "resonance"])
def test_edges_and_peaks_of_filters_are_not_lines(name: str) -> None:
    """None of 12 records behind each filter has a line, and an added line is found."""
    from scipy.signal import butter, lfilter

    pole = 0.95 * np.exp(0.4j * np.pi)
    numerator, denominator = {
        "mean of 8": (np.full(8, 1 / 8), np.ones(1)),
        "Butterworth 2": butter(2, 0.2),
        "resonance": (np.ones(1), np.array([1.0, -2 * pole.real, abs(pole) ** 2])),
    }[name]
    for seed in range(40, 52):
        samples = lfilter(numerator, denominator, noise(seed))[1000:]
        bins = dct_bins(samples.size)
        assert find_lines(dct_ordinates(samples), bins, scale=1.0, rate_hz=1.0)[0] is None
    samples += samples.std() * np.sin(1.1 * np.arange(samples.size))
    _, lines = find_lines(dct_ordinates(samples), bins, scale=1.0, rate_hz=1.0)
    assert lines[0].frequency_hz == pytest.approx(1.1 / (2 * np.pi), abs=1e-4)


@pytest.mark.parametrize("omega", [0.5 * np.pi, 1.2345])
def test_a_strong_line_is_subtracted_as_a_sine(omega: float) -> None:
    """Its tail would cover much of the spectrum; after the subtraction the noise is unchanged."""
    n = 4000
    white = np.random.default_rng(60).standard_normal(n)
    ordinates = dct_ordinates(white + 50 * np.cos(omega * (np.arange(n) + 0.5) + 1))
    rest, (sine,) = without_strong_lines(ordinates, dct_bins(n))
    assert sine.amplitude == pytest.approx(50, rel=4 / np.sqrt(n) / 50 * np.sqrt(2))
    assert sine.omega == pytest.approx(omega, abs=5 * np.sqrt(24) / 50 / n**1.5)
    # Near the line, the sine also fits the noise of three ordinates.
    far = np.abs(np.arange(1, n) - omega * n / np.pi) > 8
    np.testing.assert_allclose(rest[far], dct_ordinates(white)[far], atol=0.2)
    assert np.sum((rest - dct_ordinates(white))[~far] ** 2) < 12
    tone = sine.cosine * np.cos(sine.omega * (np.arange(n) + 0.5)) + sine.sine * np.sin(
        sine.omega * (np.arange(n) + 0.5)
    )
    np.testing.assert_allclose(sine.ordinates(n, n - 1), dct_ordinates(tone), atol=1e-8)
    left = Line(frequency_hz=10 * omega / (2 * np.pi), amplitude=1.0)
    (line,) = with_sines((left,), (sine,), scale=2.0, rate_hz=10.0)
    assert (line.frequency_hz, line.amplitude) == (sine.omega * 10 / (2 * np.pi), 2 * sine.amplitude)


def test_weak_and_wandering_lines_are_not_subtracted() -> None:
    """A sine would remove hardly any power of a strong wandering line."""
    t = np.arange(20_000)
    rng = np.random.default_rng(61)
    white = rng.standard_normal(t.size)
    wandering = 30 * np.sin(1.1 * t + 0.05 * np.cumsum(rng.standard_normal(t.size)))
    for samples in (white, white + 0.2 * np.sin(1.1 * t), white + wandering):
        ordinates = dct_ordinates(samples)
        rest, sines = without_strong_lines(ordinates, dct_bins(t.size))
        assert sines == ()
        assert rest is ordinates

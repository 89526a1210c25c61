"""Tests of the search for a band: which descriptions are sound, and what is seen above the edge."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest
from scipy import signal

from imucal.arrays import FloatArray
from imucal.fitting.spectral.disturbances.band import Band
from imucal.fitting.spectral.disturbances.band_search import (
    EDGES,
    _around_hump,
    _coarse,
    _Trial,
    find_band,
)
from imucal.fitting.spectral.disturbances.hump import Hump
from imucal.fitting.spectral.models import SHORTEST_GIVEN, Structure
from tests.fitting.fits import ordinates_of, simulated
from tests.fitting.spectral.test_band import FILTERS

RICH: Structure = ("Q", "N", "B", "GM", "K", "R")
N = 60_000


def _behind(taps: tuple[FloatArray, FloatArray], seed: int, text: str = "N=1 + B=0.1 + K=2e-3") -> FloatArray:
    raw = simulated(text, N + 2000, seed)
    return np.asarray(signal.lfilter(*taps, raw - raw[0]))[2000:]


def test_the_score_statistic_is_the_gain_of_one_more_coefficient() -> None:
    """Near a flat spectrum, it is twice the gain in log-likelihood of the fit with the coefficient."""
    for seed, coefficient in ((1, 0.0), (2, 0.02), (3, 0.05)):
        data = _coarse(ordinates_of(simulated("N=1 + K=1e-3", 40_000, seed)))
        shape = 1 / (1 + coefficient * data.lam / data.top)
        bent = replace(data, power=data.power * shape, cross=data.cross * shape, gram=data.gram * shape)
        straight = _Trial.straight(bent, ("N", "K"))
        richer = straight.bent()
        gain = 2 * float(straight.fit.objective[0] - richer.fit.objective[0])
        assert straight.bend() == pytest.approx(gain, rel=0.1, abs=0.1)
        # The richer fit is at its maximum: its own coefficient has nothing left to gain.
        assert richer.curvature.size == 1
        assert richer.bend() < 9


def test_noise_is_flat() -> None:
    """White noise, flicker, walks and a slow Gauss-Markov term need neither a bend nor a lower edge."""
    texts = ("N=1", "N=1 + B=0.3", "N=1 + K=1e-2", "N=1 + GM(sigma=0.3, T=300)", "Q=0.5 + N=1")
    for seed, text in enumerate(texts):
        data = ordinates_of(simulated(text, N, seed))
        found = find_band(data, RICH)
        assert found.flat


@pytest.mark.parametrize("name", [name for name in FILTERS if name != "resonance"])
def test_the_corner_of_a_filter_is_measured(name: str) -> None:
    """It is where the density is half of the noise below, within a cell of a sixth of an octave."""
    top, bottom = FILTERS[name]
    frequency, gain = signal.freqz(top, bottom, 20_000)
    corner = frequency[np.flatnonzero(np.abs(gain) ** 2 < 0.5)[0]] / np.pi
    found = find_band(ordinates_of(_behind((top, bottom), 5)), RICH)
    assert found.corner == pytest.approx(corner, rel=0.1)
    assert found.rise == 0.0
    assert found.poles > 0


def test_a_spectrum_that_rises_above_the_edge_has_no_corner() -> None:
    """A resonance and a weak vibration rise; N is the level below them."""
    resonance = _behind(FILTERS["resonance"], 7)
    passed = signal.butter(2, (0.04, 0.16), "band")
    white = np.random.default_rng(8).standard_normal(N)
    vibration = simulated("N=1", N, 8) + 0.7 * signal.lfilter(*passed, white)
    for samples in (resonance, vibration):
        found = find_band(ordinates_of(samples), RICH)
        assert found.fraction < 1
        assert found.rise > 1.2
        assert found.corner is None


def test_the_edge_is_the_highest_sound_one() -> None:
    """Below the edge the description is sound; at each higher edge no description is."""
    data = ordinates_of(_behind(FILTERS["mean of 5"], 11))
    found = find_band(data, RICH)
    coarse = _coarse(data)
    plain = tuple(symbol for symbol in RICH if symbol != "Q")
    for edge in EDGES:
        straight = _Trial.straight(coarse.below(edge), plain, edge=edge, shortest=10 / edge)
        sound = any(one.is_sound(most=3.0, bend=9.0) for one in (straight, straight.bent()))
        assert sound == (edge == found.fraction)
        if sound:
            break


def test_a_term_that_hides_the_white_noise_is_taken_for_a_filter() -> None:
    """Smoothing has the spectrum of a Gauss-Markov term; the band allows only much slower terms."""
    samples = _behind((np.array([0.05]), np.array([1, -0.95])), 3, "N=1")
    found = find_band(ordinates_of(samples), RICH)
    assert found.masked == pytest.approx(-1 / np.log(0.95), rel=0.1)
    assert found.shortest >= 10 * found.masked
    assert not found.flat


def test_white_noise_that_is_only_rounding_is_no_white_noise() -> None:
    """Rounding behind smoothing is flat at the top; without its variance it would be taken for N."""
    smooth = _behind((np.array([0.05]), np.array([1, -0.95])), 4, "N=1")
    step = 0.16
    data = ordinates_of(np.round(smooth / step) * step)
    assert find_band(data, RICH).masked == 0
    assert find_band(data, RICH, rounding=lambda: step**2 / 12).masked > 0


def test_a_given_structure_may_have_short_terms() -> None:
    """If it describes the whole spectrum with white noise at the top, there is no search."""
    data = ordinates_of(simulated("N=1 + GM(sigma=1, T=5)", N, 1))
    found = find_band(data, RICH, given=("N", "GM"))
    assert found.flat
    assert found.shortest == SHORTEST_GIVEN
    assert not find_band(data, RICH, given=("N", "K")).flat


def test_a_search_near_the_right_band_finds_the_same_band() -> None:
    samples = np.convolve(simulated("N=1", 20_000, 41), np.full(9, 1 / 9), "valid")
    data = ordinates_of(samples)
    searched = find_band(data, ("Q", "N", "GM", "K"))
    assert searched.fraction < 1.0
    near = find_band(data, ("Q", "N", "GM", "K"), near=searched.fraction)
    assert (near.fraction, near.poles) == (searched.fraction, searched.poles)
    npt.assert_allclose(near.response, searched.response, rtol=1e-6)


def test_a_spectrum_without_a_sound_description_uses_the_least_bad_one() -> None:
    """Here the power of every bin is random; the fit reports the misfit."""
    data = ordinates_of(simulated("N=1", 40_000, 1))
    wild = replace(data, power=data.power * np.random.default_rng(1).lognormal(0, 3, data.size.size))
    found = find_band(wild, RICH)
    assert found.statistic > 3


def test_a_short_record_keeps_its_whole_spectrum() -> None:
    """With fewer than 24 bins there is nothing to search."""
    data = ordinates_of(simulated("K=1", 16, 1))
    found = find_band(data, ("N", "GM", "K"))
    assert found.fraction == 1.0
    assert found.poles == 0


def test_a_band_selects_the_bins_outside_its_hump() -> None:
    """Bins beyond the end of the band are not selected either."""
    data = ordinates_of(simulated("N=1", 2000, 1))
    hump = Hump(low=0.1, high=0.2, times=3.0)
    found = Band(fraction=0.5, hump=hump).select(data)
    expected = (data.fraction <= 0.5) & ~((data.fraction >= 0.1) & (data.fraction <= 0.2))
    npt.assert_array_equal(found.lam, data.lam[expected])
    assert found.top == pytest.approx(4 * np.sin(np.pi / 4) ** 2)
    assert not Band(hump=hump).flat


def test_a_hump_must_describe_the_spectrum_better_than_a_flat_band() -> None:
    """By more than 1 in the statistic of the misfit."""
    samples = simulated("N=1e-4 + B=5e-5", 60_000, 3, rate_hz=100.0)
    passed = signal.butter(1, (0.02, 0.05), "band")
    white = np.random.default_rng(3).standard_normal(samples.size)
    coarse = _coarse(ordinates_of(samples + 4e-3 * signal.lfilter(*passed, white)))
    rich = ("N", "B", "K")
    alone = _around_hump(coarse, rich, None)
    assert alone is not None
    assert alone.hump is not None
    flat = _Trial.straight(coarse, rich)
    worse, better = (replace(flat, statistic=alone.statistic + more) for more in (2.0, 0.5))
    found = _around_hump(coarse, rich, worse)
    assert found is not None
    assert found.hump == alone.hump
    assert _around_hump(coarse, rich, better) is None

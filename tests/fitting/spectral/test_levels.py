"""Two readings of the white noise: the limits of N contain both, and a warning names them."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt

from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Estimate, Interval
from imucal.fitting.spectral.disturbances.levels import (
    Level,
    hidden_levels,
    level_at_the_top,
    outside,
    with_levels,
)
from tests.fitting.fits import fitted, ordinates_of

#: Sampling rate of the records, in Hz, and their N and B, in U.
RATE = 100.0
N = 1e-4
B = 3e-5


def _white(rng: np.random.Generator, n: int) -> FloatArray:
    return np.asarray(N * np.sqrt(RATE) * rng.standard_normal(n))


def _flicker(rng: np.random.Generator, n: int) -> FloatArray:
    """1/f noise with the two-sided density B²/(2 pi f): a part of a longer record, which has no period."""
    size = 4 * n
    frequency = np.fft.rfftfreq(size, 1 / RATE)
    frequency[0] = frequency[1]
    spectrum = np.fft.rfft(rng.standard_normal(size)) * np.sqrt(RATE * B**2 / (2 * np.pi * frequency))
    return np.asarray(np.fft.irfft(spectrum, size)[n : 2 * n])


def _smoothed(samples: FloatArray, share: float) -> FloatArray:
    return np.asarray(lfilter([share], [1, share - 1], samples))


def _vibrating(rng: np.random.Generator, n: int, low: float, high: float, power: float) -> FloatArray:
    """Return a band whose density is `power` times N²."""
    sos = butter(2, (low, high), "band", fs=RATE, output="sos")
    return np.asarray(sosfilt(sos, np.sqrt(power) * _white(rng, n + 4000))[4000:])


@pytest.mark.parametrize("seed", [11, 12])
def test_smoothing_with_a_little_noise_behind_it_has_two_readings(seed: int) -> None:
    """The noise behind it has 0.05 N; both values of N are within the limits, and the warning names both."""
    rng = np.random.default_rng(seed)
    n = 60_000
    found = fitted(_smoothed(_white(rng, n), 0.05) + 0.05 * _white(rng, n) + _flicker(rng, n), rate_hz=RATE)
    assert found["N"].low < 0.05 * N * 1.03
    assert found["N"].high > N
    (warning,) = [finding for finding in found.findings if finding.code == "two-levels"]
    assert warning.level == "warning"
    assert "smoothing filter" in warning.text


@pytest.mark.parametrize(("low", "high", "power"), [(2, 8, 0.25), (2, 8, 0.5), (0.5, 2, 0.5)])
def test_n_beside_a_weak_vibration_is_within_its_limits(low: float, high: float, power: float) -> None:
    """The mean square of the residuals does not show such a band."""
    for seed in (21, 22):
        rng = np.random.default_rng(seed)
        n = 60_000
        samples = _white(rng, n) + _flicker(rng, n) + _vibrating(rng, n, low, high, power)
        found = fitted(samples, rate_hz=RATE)
        assert found["N"].low <= N <= found["N"].high


def test_clean_records_and_plain_filters_have_one_reading() -> None:
    """A smoothing filter falls up to the highest frequency."""
    for seed in range(6):
        rng = np.random.default_rng([31, seed])
        n = 40_000
        samples = _white(rng, n) + _flicker(rng, n)
        if seed % 2:
            samples = _smoothed(_white(rng, n), 0.3) + _flicker(rng, n)
        found = fitted(samples, rate_hz=RATE)
        assert "two-levels" not in [finding.code for finding in found.findings]


def test_the_upper_octave_of_white_noise_has_its_level() -> None:
    """The standard error is that of a variance from half of the ordinates."""
    samples = np.random.default_rng(41).standard_normal(40_000)
    level = level_at_the_top(ordinates_of(samples), np.zeros(1), rounding=0)
    assert level is not None
    assert level[1] == pytest.approx(np.sqrt(2 / 20_000), rel=1e-2)
    assert level[0] == pytest.approx(1.0, abs=4 * level[1])


def test_a_spectrum_that_falls_or_rises_at_the_top_has_no_level() -> None:
    samples = np.random.default_rng(42).standard_normal(40_000)
    for bent in (_smoothed(samples, 0.3), np.diff(samples)):
        assert level_at_the_top(ordinates_of(bent), np.zeros(1), rounding=0) is None


def test_rounding_and_short_records_have_no_level() -> None:
    """A level below three times that of the rounding is not the sensor's."""
    samples = np.random.default_rng(43).standard_normal(40_000)
    assert level_at_the_top(ordinates_of(samples), np.zeros(1), rounding=0.4) is None
    assert level_at_the_top(ordinates_of(samples[:400]), np.zeros(1), rounding=0) is None


def _estimate(key: str, value: float, low: float, high: float, time_s: float = 0.0) -> Estimate:
    time = Interval(value=time_s, low=0.8 * time_s, high=1.2 * time_s) if time_s else None
    return Estimate(
        key=key, symbol=key, status="estimated", value=value, low=low, high=high, correlation_time=time
    )


def test_a_short_gauss_markov_term_that_hides_white_noise_is_a_reading() -> None:
    """Its density is 2 sigma² T: above four times that of the white noise, if T is below 100 samples."""
    white = _estimate("N", 1.0, 0.9, 1.1)
    hiding = _estimate("GM", 2.0, 1.8, 2.2, 0.9)
    (level,) = hidden_levels([white, hiding], tau0=0.01)
    assert level.value == pytest.approx(np.sqrt(1 + 2 * 4 * 0.9))
    assert level.high == pytest.approx(np.sqrt(1 + 2 * 2.2**2 * 1.2 * 0.9))
    assert not hidden_levels([white, hiding], tau0=0.0089)
    assert not hidden_levels([white, _estimate("GM", 2.0, 1.8, 2.2, 0.49)], tau0=0.01)


def test_limits_contain_other_levels_and_the_value_stays() -> None:
    white, walk = _estimate("N", 1.0, 0.9, 1.1), _estimate("K", 1.0, 0.9, 1.1)
    top = Level(value=0.5, low=0.49, high=0.51, cause="a filter")
    levels = outside([white, walk], [top])
    assert levels == (top,)
    wider = with_levels([white, walk], levels)
    assert (wider[0].value, wider[0].low, wider[0].high) == (1.0, 0.49, 1.1)
    assert wider[1] == walk
    inside = Level(value=1.05, low=1.0, high=1.2, cause="a filter")
    assert not outside([white, walk], [inside])
    assert with_levels([white, walk], ()) == (white, walk)

"""Tests of output filters: N is the noise before the filter, and the filter is reported."""

import numpy as np
import pytest
from scipy import signal

from imucal.arrays import FloatArray
from tests.fitting.fits import fitted, simulated
from tests.slow_cases import first_by_default

TEXT = "N=1 + B=0.1 + K=2e-3"
N = 200_000


def filtered(top: FloatArray, bottom: FloatArray, seed: int) -> FloatArray:
    """Return noise behind a filter that has settled."""
    raw = simulated(TEXT, N + 2000, seed)
    return np.asarray(signal.lfilter(top, bottom, raw - raw[0]))[2000:]


def one_pole(corner: float) -> tuple[FloatArray, FloatArray]:
    pole = np.exp(-np.pi * corner)
    return np.array([1 - pole]), np.array([1.0, -pole])


FILTERS = {
    "one-pole": one_pole(0.15),
    "butterworth-1": signal.butter(1, 0.35),
    "butterworth-2": signal.butter(2, 0.25),
    "butterworth-4": signal.butter(4, 0.6),
    "two one-poles": (
        np.convolve(one_pole(0.3)[0], one_pole(0.3)[0]),
        np.convolve(one_pole(0.3)[1], one_pole(0.3)[1]),
    ),
    "mean of 5": (np.ones(5) / 5, np.ones(1)),
    "resonance": (np.array([1 - 1.2 * np.cos(1.2) + 0.36]), np.array([1.0, -1.2 * np.cos(1.2), 0.36])),
    "chebyshev": signal.cheby1(3, 0.5, 0.45),
}


@pytest.mark.parametrize("name", first_by_default(FILTERS, 2))
def test_n_is_right_behind_a_filter(name: str) -> None:
    """The interval of N covers the truth in at least three of four records."""
    hits, errors = [], []
    for seed in range(4):
        result = fitted(filtered(*FILTERS[name], seed), "N + B + K")
        assert result["N"].value is not None
        errors.append(result["N"].value - 1)
        hits.append(result["N"].low <= 1 <= result["N"].high)
    # The standard error of N behind these filters is up to 1 %.
    assert np.max(np.abs(errors)) < 0.04
    # At a coverage of 95 %, two or more misses in four records have a probability of 1.4 %.
    assert sum(hits) >= 3


@pytest.mark.parametrize(("name", "corner"), [("one-pole", 0.15), ("butterworth-2", 0.25)])
def test_the_filter_and_its_corner_are_reported(name: str, corner: float) -> None:
    result = fitted(filtered(*FILTERS[name], 1), "N + B + K")
    assert result.response is not None
    assert result.response.cutoff_hz == pytest.approx(corner / 2, rel=0.05)
    texts = [f.text for f in result.findings if f.code == "output-filter"]
    assert len(texts) == 1
    assert f"-3 dB at {result.response.cutoff_hz:.4g} Hz" in texts[0]


def test_noise_without_a_filter_uses_the_full_band() -> None:
    """No filter is found in any of ten records."""
    for seed in range(10):
        result = fitted(simulated(TEXT, 50_000, seed), "N + B + K")
        assert result.response is None
        assert result.goodness.band_hz is not None
        assert result.goodness.band_hz[1] == 0.5


def test_auto_keeps_n_in_the_model_behind_a_filter() -> None:
    """White noise behind a one-pole filter is N behind a filter, not a Gauss-Markov term."""
    result = fitted(filtered(*FILTERS["one-pole"], 2))
    assert result["N"].status == "estimated"
    assert result["N"].low < 1 < result["N"].high
    assert "GM" not in str(result.model)


def test_given_gauss_markov_terms_may_be_short() -> None:
    """A correlation time of five samples next to white noise is not a filter if the model contains GM."""
    result = fitted(simulated("N=1 + GM(sigma=1, T=5) + GM(sigma=1, T=200)", 100_000, 1), "N + 2*GM")
    assert result.response is None
    times = [e.correlation_time for e in result.estimates if e.symbol == "GM"]
    assert times[0] is not None
    assert times[1] is not None
    assert times[0].low < 5 < times[0].high
    assert times[1].low < 200 < times[1].high


@pytest.mark.parametrize("share", first_by_default([0.05, 0.12, 0.02], 1))
def test_smoothing_is_a_filter(share: float) -> None:
    """Smoothing, y += a (x - y), has the spectrum of a Gauss-Markov term; N is the noise before it."""
    covered = {"N": 0, "B": 0}
    for seed in range(4):
        samples = simulated("N=1e-4 + B=3e-5", 60_000, seed, rate_hz=100.0)
        smooth = signal.lfilter([share], [1, share - 1], samples - samples[0])[500:]
        fit = fitted(smooth, rate_hz=100.0)
        covered["N"] += fit["N"].low <= 1e-4 <= fit["N"].high
        covered["B"] += fit["B"].low <= 3e-5 <= fit["B"].high
        (found,) = (finding for finding in fit.findings if finding.code == "output-filter")
        # A Gauss-Markov term of more than ten samples would explain the spectrum equally well.
        if share < 0.1:
            assert found.level == "warning"
    assert covered["N"] >= 3
    assert covered["B"] >= 3

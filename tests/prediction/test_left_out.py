"""Tests of the noise that a fit leaves out: its ratio is that of the true error, and clean logs have none."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import TypeAlias

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

import imucal
from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import NoiseFit
from imucal.noise.model import NoiseModel
from imucal.prediction import filter_numbers
from imucal.prediction.left_out import LeftOut, causes, left_out, left_out_of_model

#: Returns a number of samples of a disturbance.
Disturb: TypeAlias = Callable[[int, np.random.Generator], FloatArray]
RATE_HZ = 100.0
N = 1e-4


def fitted(samples: FloatArray) -> NoiseFit:
    return imucal.fit(imucal.AxisSeries.from_samples(samples, rate_hz=RATE_HZ))


def white(count: int, rng: np.random.Generator) -> FloatArray:
    return np.asarray(N * np.sqrt(RATE_HZ) * rng.standard_normal(count))


def vibration(count: int, rng: np.random.Generator) -> FloatArray:
    """Return a sway of 0.3 to 1.5 Hz whose density is about 15 times that of the noise."""
    band = butter(2, [0.3, 1.5], "band", fs=RATE_HZ, output="sos")
    return np.asarray(4 * N * np.sqrt(RATE_HZ) * sosfilt(band, rng.standard_normal(count)))


def spikes(count: int, rng: np.random.Generator) -> FloatArray:
    """Return spikes of 50 deviations whose density is 1.25 N²."""
    found = np.zeros(count)
    found[rng.integers(0, count, count // 2000)] = 50 * N * np.sqrt(RATE_HZ)
    return found


@cache
def fit_with(disturb: Disturb) -> NoiseFit:
    rng = np.random.default_rng(5701)
    return fitted(white(120_000, rng) + disturb(120_000, rng))


def white_of(n: float) -> Callable[[FloatArray], FloatArray]:
    """Return the Allan variance of white noise N as a function of time."""
    return lambda t: n**2 / t


def beyond(fit: NoiseFit) -> LeftOut:
    found = left_out_of_model(fit, fit.model.terms)
    assert found is not None
    return found


@pytest.mark.parametrize(("disturb", "name"), [(vibration, "a vibration"), (spikes, "spikes")])
def test_the_ratio_is_that_of_the_error_of_dead_reckoning(disturb: Disturb, name: str) -> None:
    """The error in 1 s and 10 s over that of the fitted noise, from 20 000 s of new samples.

    Of a vibration whose period is the averaging time the Allan deviation is up to a quarter larger.
    """
    fit = fit_with(disturb)
    assert causes(fit.findings) == name
    rng = np.random.default_rng(5702)
    angle = np.concatenate([[0.0], np.cumsum(white(2_000_000, rng) + disturb(2_000_000, rng)) / RATE_HZ])
    ratios = dict(beyond(fit).ratios)
    assert 1.0 in ratios
    for time_s, ratio in ratios.items():
        change = np.diff(angle[:: round(time_s * RATE_HZ)])
        # The mean rate of the log belongs to the bias.
        error = np.std(change) / (N * np.sqrt(time_s))
        assert 0.9 * error < ratio < 1.25 * error


def test_the_factor_on_the_white_noise_includes_what_was_left_out() -> None:
    """With it nothing is left out; with a fifth less, something still is."""
    fit = fit_with(spikes)
    factor = beyond(fit).white
    n = fit["N"].value
    assert n is not None
    assert left_out(fit, white_of(factor * n), np.zeros_like) is None
    assert left_out(fit, white_of(0.8 * factor * n), np.zeros_like) is not None


@pytest.mark.parametrize("text", ["N=1e-4", "N=1e-4 + B=3e-5", "N=1e-4 + K=5e-6", "Q=3e-6 + N=1e-4"])
def test_clean_records_leave_out_nothing(text: str) -> None:
    """Neither beyond the model nor beyond the pair of a filter."""
    for seed in range(3):
        samples = NoiseModel.parse(text).simulate(
            60_000, rate_hz=RATE_HZ, rng=np.random.default_rng([5703, seed])
        )
        fit = fitted(samples)
        pair = filter_numbers([fit])
        assert left_out_of_model(fit, fit.model.terms) is None
        assert left_out(fit, white_of(pair.white), pair.slow_avar) is None


def test_times_within_a_step_of_the_filter_do_not_count() -> None:
    """A filter that is aided every 10 s averages a sway of 1 s."""
    fit = fit_with(vibration)
    n = fit["N"].value
    assert n is not None
    found = left_out(fit, white_of(n), np.zeros_like, step_s=1.0)
    assert found is not None
    assert found.ratios[0][0] == 1.0
    found = left_out(fit, white_of(n), np.zeros_like, step_s=10.0)
    assert found is None or [time for time, _ in found.ratios] == [10.0]


def test_a_model_without_a_measured_curve_leaves_out_nothing() -> None:
    """The curve of a data sheet is that of the model."""
    fit = fit_with(spikes)
    given = replace(fit, curve=replace(fit.curve, computed="given"))
    assert left_out_of_model(given, fit.model.terms) is None

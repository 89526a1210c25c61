"""Tests of flicker noise as a bank of Gauss-Markov terms."""

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.noise.terms import BiasInstability, GaussMarkov


def _density(B: float, per_decade: float, f: FloatArray) -> FloatArray:
    bank = GaussMarkov.bank(B, 1e-4, 1e10, per_decade)
    return np.asarray(sum(2 * t.sigma**2 * t.T / (1 + (2 * np.pi * f * t.T) ** 2) for t in bank))


@pytest.mark.parametrize(("per_decade", "ripple"), [(1.0, 0.055), (1.5, 0.0065), (2.0, 0.0008)])
def test_the_density_ripples_as_published(per_decade: float, ripple: float) -> None:
    """The ripple about B²/(2 pi f) is half the range over a decade, right to 10 %."""
    f = np.geomspace(1e-3, 1e-1, 2000)
    ratio = _density(0.3, per_decade, f) * 2 * np.pi * f / 0.3**2
    assert np.ptp(ratio) / 2 == pytest.approx(ripple, rel=0.1)
    assert ratio.mean() == pytest.approx(1, abs=1e-3)


def test_the_sampled_bank_agrees_with_flicker_up_to_nyquist() -> None:
    """With t_min = tau0/2, the sampled density is right to 1.5 %, and to 12 % at Nyquist."""
    rate, n = 100.0, 100_000
    f = np.geomspace(rate / n, rate / 2, 300)
    bank = GaussMarkov.bank(0.02, 0.5 / rate, 0.5 / rate * 10**6.5, 2.0)
    ratio = sum(t.psd(f, 1 / rate) for t in bank) / BiasInstability(value=0.02).psd(f, 1 / rate)
    assert np.all(np.abs(ratio[f < 0.1 * rate] - 1) < 0.015)
    assert np.all(np.abs(ratio - 1) < 0.12)


def test_the_longest_time_is_reached() -> None:
    """The last correlation time is the first at or beyond t_max."""
    times = [term.T for term in GaussMarkov.bank(1.0, 1.0, 1000.0, 2.0)]
    assert times[0] == 1.0
    assert times[-1] == pytest.approx(1000.0)
    assert len(times) == 7


def test_times_that_do_not_increase_are_rejected() -> None:
    """The error repeats the arguments."""
    with pytest.raises(ValueError, match=r"need 0 < t_min < t_max, B > 0 and per_decade > 0, got 2\.0, 1\.0"):
        GaussMarkov.bank(1.0, 2.0, 1.0)

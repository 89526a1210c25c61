"""Spectral lines."""

import numpy as np
import pytest

from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.fitting.spectral.lines import find_lines
from imucal.noise.model import NoiseModel

N = 60_000


def noise(seed: int) -> np.typing.NDArray[np.float64]:
    return NoiseModel.parse("N=1 + K=3e-3").simulate(N, rate_hz=1.0, rng=np.random.default_rng(seed))


@pytest.mark.parametrize(("place", "amplitude"), [(0.0123, 0.2), (0.2, 0.1), (0.4321, 1.0)])
def test_finds_frequency_and_amplitude(place: float, amplitude: float) -> None:
    """The strongest line is the sine that was added, to a few parts in a hundred."""
    samples = noise(1) + amplitude * np.sin(2 * np.pi * place * np.arange(N) + 0.4)
    kept, lines = find_lines(dct_ordinates(samples), dct_bins(N), scale=2.0, rate_hz=100.0)
    assert kept is not None
    assert lines[0].frequency_hz == pytest.approx(100 * place, abs=100 / N)
    assert lines[0].amplitude == pytest.approx(2 * amplitude, rel=0.1)


def test_finds_none_in_noise() -> None:
    """One record in a hundred may show a line that is not there; of thirty at most two."""
    found = [find_lines(dct_ordinates(noise(s)), dct_bins(N), scale=1.0, rate_hz=1.0)[0] for s in range(30)]
    assert sum(kept is not None for kept in found) <= 2


def test_never_takes_the_lowest_ordinates() -> None:
    """A strong drift is not a line."""
    samples = noise(2) + 1e-2 * np.arange(N)
    kept, _ = find_lines(dct_ordinates(samples), dct_bins(N), scale=1.0, rate_hz=1.0)
    assert kept is None or kept[:24].all()

"""Records of one unit: simulated samples, their bins, and fits with replaced bins."""

from dataclasses import replace
from functools import cache

import numpy as np

import imucal
from imucal.arrays import FloatArray
from imucal.fitting import NoiseFit
from imucal.fitting.bins import Bins
from imucal.fitting.spectral.blocks import bin_blocks, bins_of, make_blocks
from imucal.recording import AxisSeries

RATE = 100.0


def simulated(text: str, n: int, *seed: int) -> FloatArray:
    """Return n samples of a model."""
    model = imucal.NoiseModel.parse(text)
    return model.simulate(n, rate_hz=RATE, rng=np.random.default_rng(seed))


def fit_of(samples: FloatArray, model: str = "N + B + K") -> NoiseFit:
    """Return the complete fit of samples with one segment."""
    return imucal.fit(AxisSeries.from_samples(samples, rate_hz=RATE), model=model, segments=1)


def bins_from(samples: FloatArray) -> Bins:
    """Return the bins of samples that contain only noise."""
    series = AxisSeries.from_samples(samples, rate_hz=RATE).finite()
    blocks = make_blocks(series)
    return bins_of(bin_blocks(blocks.blocks, blocks.scale), blocks, tau0=series.tau0, widening=1.0)


def quick_fit(samples: FloatArray) -> NoiseFit:
    """Return a constant fit with the sensor, rate, filter and bins of the samples."""
    return replace(_any_fit(), bins=bins_from(samples))


@cache
def _any_fit() -> NoiseFit:
    return fit_of(simulated("N=1", 500, 0))

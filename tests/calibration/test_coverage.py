"""Coverage of all parameters by the whole command: hand, Gauss-Markov noise, earth rate, warm-up, few rests.

`tests/benchmarks/calibration.py` prints each group of parameters for 200 logs.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import imucal
from imucal import calibrate
from imucal.calibration import Calibration
from imucal.calibration.noise_source import _model
from imucal.noise import NoiseModel
from imucal.recording import AXES, Sensor
from tests.calibration.simulated import (
    GRAVITY,
    RATE,
    Log,
    Truth,
    attitudes,
    held,
    log,
    truth_inside,
    warmed,
    within_binomial,
)

#: Noise of an accelerometer and of a gyroscope.
CONSUMER = NoiseModel.parse("N=2e-3 + B=5e-4 + K=5e-5"), NoiseModel.parse("N=1.5e-4 + B=2e-5 + K=2e-6")
QUIET = CONSUMER[0], NoiseModel.parse("N=2e-5 + B=1e-6")
GAUSS_MARKOV = (
    NoiseModel.parse("N=2e-3 + GM(sigma=1e-3, T=50)"),
    NoiseModel.parse("N=1.5e-4 + GM(sigma=5e-5, T=50)"),
)


@dataclass(frozen=True)
class Case:
    """A kind of log, its noise (of the log and of the report), and arguments of `calibrate`."""

    noise: tuple[NoiseModel, NoiseModel] = CONSUMER
    reported: bool = True
    latitude: float = 47.4
    count: int = 18
    change: Callable[[Log, Truth, np.random.Generator], Log] = field(default=lambda one, *_: one)
    sensitivity: float | None = None
    arguments: dict[str, Any] = field(default_factory=dict)

    def draw(self, seed: int) -> tuple[Truth, Log, Calibration]:
        """Return a log with its truth and its calibration."""
        rng = np.random.default_rng(seed)
        truth = Truth.draw(rng)
        if self.sensitivity is not None:
            truth.G[:] = rng.normal(0, self.sensitivity, (3, 3))
        one = log(truth, self.noise, attitudes(self.count, rng), rng, latitude=self.latitude)
        one = self.change(one, truth, rng)
        models = {f"{s.short}_{axis}": self.noise[s is Sensor.GYROSCOPE] for s in Sensor for axis in AXES}
        known = {"noise": models if self.reported else None, "latitude": self.latitude, "gravity": GRAVITY}
        return truth, one, calibrate(one.recording(), **{**known, **self.arguments})


CASES = {
    "in a calm hand": Case(
        reported=False,
        change=lambda one, truth, rng: held(one, truth, rng, size=0.5),
        arguments={"in_hand": True},
    ),
    "Gauss-Markov noise": Case(noise=GAUSS_MARKOV),
    "a quiet gyroscope at the equator": Case(noise=QUIET, latitude=0.0),
    "a quiet gyroscope at an unknown latitude": Case(noise=QUIET, arguments={"latitude": None}),
    "a warm-up": Case(reported=False, change=lambda one, *_: warmed(one, (2e-2, 1e-3), 60.0)),
    "too few rests for misalignments": Case(count=8),
    "a G that is not significant": Case(sensitivity=3e-6, count=14),
}


def inside(case: Case, seeds: range) -> tuple[list[list[bool]], list[Calibration]]:
    """Return which intervals of each log contain the truth, and the calibrations."""
    hits, results = [], []
    for seed in seeds:
        truth, one, found = case.draw(seed)
        hits.append(list(truth_inside(truth, one, found).values()))
        results.append(found)
    return hits, results


@pytest.mark.parametrize("name", CASES)
def test_intervals_contain_the_truth(name: str) -> None:
    """Thirty parameters of five logs, correlated within a log."""
    hits, results = inside(CASES[name], range(740_000, 740_005))
    assert within_binomial(np.array([np.mean(each) for each in hits])[:, None], 0.92, 1.0)
    codes = [{finding.code for finding in found.findings} for found in results]
    if name == "a warm-up":
        assert sum("warming" in each for each in codes) >= 4
    if name == "a G that is not significant":
        applied = [found.gyroscope is not None and found.gyroscope.rest.significant for found in results]
        assert sum(applied) <= 2


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_intervals_contain_the_truth_in_a_hundred_logs(name: str) -> None:
    """At least 92 %."""
    hits, _ = inside(CASES[name], range(741_000, 741_100))
    assert within_binomial(np.array([np.mean(each) for each in hits])[:, None], 0.92, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("T", [5, 500])
def test_a_report_of_half_an_hour_serves_gauss_markov_noise(T: int) -> None:
    """The fit may call it GM, B or K, or only bound it."""
    noise = (
        NoiseModel.parse(f"N=2e-3 + GM(sigma=1e-3, T={T})"),
        NoiseModel.parse(f"N=1.5e-4 + GM(sigma=5e-5, T={T})"),
    )
    fitted = [
        [
            _model(
                imucal.fit(model.simulate(180_000, rate_hz=RATE, rng=np.random.default_rng(k)), rate_hz=RATE)
            )
            for k in range(3)
        ]
        for model in noise
    ]
    known = {
        f"{s.short}_{axis}": fitted[s is Sensor.GYROSCOPE][k] for s in Sensor for k, axis in enumerate(AXES)
    }
    hits, _ = inside(Case(noise=noise, arguments={"noise": known}), range(742_000, 742_040))
    assert within_binomial(np.array([np.mean(each) for each in hits])[:, None], 0.90, 1.0)


@pytest.mark.slow
def test_intervals_of_the_bias_include_the_white_noise_of_the_log() -> None:
    """93 to 97 % of 180 biases of gyroscopes whose white noise is large, and of their accelerometers."""
    noisy = Case(noise=(CONSUMER[0], NoiseModel.parse("N=6e-4 + B=2e-5")), reported=False, count=14)
    hits = []
    for seed in range(743_000, 743_060):
        truth, one, found = noisy.draw(seed)
        inside_intervals = truth_inside(truth, one, found)
        hits.append([hit for name, hit in inside_intervals.items() if "bias" in name])
    assert within_binomial(np.array(hits), 0.93, 0.98)

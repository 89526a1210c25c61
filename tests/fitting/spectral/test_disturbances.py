"""Tests of the search for disturbances: cycles, steps, warm-ups and temperature are found and removed."""

import re

import numpy as np
import pytest

from imucal.allan import allan_curve
from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.fitting import FitSettings, NoiseFit
from imucal.fitting.cross_checks import without_disturbances
from imucal.fitting.regressors import Bump, LevelChange, Ramp, Regressor, Step, WarmUp, Wave, lagged
from imucal.fitting.spectral import fit_mle
from imucal.fitting.spectral.blocks import Block, make_blocks
from imucal.fitting.spectral.disturbances.shapes import Disturbance, find_disturbances, with_shape
from imucal.fitting.spectral.disturbances.whitened import Whitened
from imucal.noise.model import NoiseModel
from imucal.recording import Axis, AxisSeries, Sensor
from tests.fitting.fits import fitted, simulated

N = 60_000
T = np.arange(N) / 10.0
#: A random walk that is large enough to be detected, at 10 Hz.
TRUTH = "N=1e-4 + K=1e-6"


def noise(seed: int, text: str = TRUTH) -> FloatArray:
    """Return 100 min of noise."""
    return simulated(text, N, seed, rate_hz=10.0)


def found(samples: FloatArray, temperature: FloatArray | None = None) -> list[Disturbance[Regressor]]:
    """Return the disturbances found in samples at 10 Hz, with sizes in U."""
    blocks = make_blocks(AxisSeries.from_samples(samples, rate_hz=10.0), temperature)
    return list(find_disturbances(blocks.blocks)[0])


def agrees_with_undisturbed(fit: NoiseFit, plain: FloatArray) -> bool:
    """Whether the upper limits of N, B and K agree with the fit of the undisturbed samples."""
    other = fitted(plain, rate_hz=10.0)
    return all(0.5 < fit[key].high / other[key].high < 1.5 for key in ("N", "B", "K"))


def sentence(fit: NoiseFit, code: str) -> str:
    """Return the text of the only finding with this code."""
    (finding,) = [finding for finding in fit.findings if finding.code == code]
    return finding.text


@pytest.mark.parametrize(("periods", "seed"), [(2.6, 1), (7.3, 2), (23.4, 3)])
def test_a_cycle_is_found_with_its_period_and_amplitude(periods: float, seed: int) -> None:
    """K agrees with the undisturbed fit; with the cycle in the data it would be several times too large."""
    cycle = 1e-4 * np.sin(2 * np.pi * periods * np.arange(N) / N + 0.7)
    fit = fitted(noise(seed) + cycle, rate_hz=10.0)
    (finding,) = [finding for finding in fit.findings if finding.code == "cycle"]
    assert finding.level == "warning"
    words = finding.text.removeprefix("The axis swings with a period of ").split()
    assert float(words[0]) == pytest.approx(N / 10 / periods, rel=0.06 / periods)
    assert float(words[3]) == pytest.approx(1e-4, rel=0.35)
    assert agrees_with_undisturbed(fit, noise(seed))


def test_the_harmonics_of_a_thermostat_cycle_are_removed() -> None:
    """A triangle wave has a third and a fifth harmonic; one finding lists all, the strongest first."""
    angle = 2 * np.pi * 4.2 * np.arange(N) / N
    fit = fitted(noise(4) + 1e-3 * np.arcsin(np.sin(angle)) * 2 / np.pi, rate_hz=10.0)
    text = sentence(fit, "cycle")
    parts = text.removeprefix("The axis swings with a period of ").split("), ")
    periods = [float(part.split()[0]) for part in parts]
    assert periods[:2] == pytest.approx([6000 / 4.2, 2000 / 4.2], rel=0.02)
    # The remaining higher harmonics are small compared with the random walk.
    assert fit["K"].high < 2e-6


@pytest.mark.parametrize(("place", "height", "seed"), [(0.3, 2e-4, 5), (0.77, -2e-4, 6), (0.5, 1e-2, 7)])
def test_a_step_is_found_and_removed(place: float, height: float, seed: int) -> None:
    """The time is as exact as the noise permits (a large step: to the sample); B and K are not affected."""
    at = int(place * N)
    fit = fitted(noise(seed) + height * (np.arange(N) >= at), rate_hz=10.0)
    (finding,) = [finding for finding in fit.findings if finding.code == "step"]
    words = finding.text.removeprefix("The level jumps by ").split()
    assert float(words[0]) == pytest.approx(height, rel=0.35 if abs(height) < 1e-3 else 0.01)
    assert float(words[3]) == pytest.approx(at / 10, abs=1500 * (1e-5 / height) ** 2 + 0.11)
    assert finding.keep_s is not None
    assert finding.keep_s[1] - finding.keep_s[0] == pytest.approx(max(place, 1 - place) * N / 10, abs=30)
    assert agrees_with_undisturbed(fit, noise(seed))


def test_a_gradual_shift_is_reported_as_one_step() -> None:
    """A shift that takes about a minute is several steps in one direction; the finding merges them."""
    fit = fitted(noise(23) + 4e-4 / (1 + np.exp(-(T - 3000) / 15)), rate_hz=10.0)
    words = sentence(fit, "step").removeprefix("The level jumps by ").split()
    assert float(words[0]) == pytest.approx(4e-4, rel=0.3)
    assert words[2] == "from"
    assert 2900 < float(words[3]) < 3000 < float(words[5]) < 3100
    assert "and stays there" in sentence(fit, "step")
    assert agrees_with_undisturbed(fit, noise(23))


@pytest.mark.parametrize("lag", [0.0, 60.0])
def test_a_temperature_effect_is_removed_with_its_lag(lag: float) -> None:
    """The axis follows a thermostat's cycle with a lag of 0 or 60 s; no cycle or step is reported."""
    rng = np.random.default_rng(8)
    warm = 25 + np.sin(2 * np.pi * T / 800) + 0.02 * rng.standard_normal(N)
    fit = fitted(noise(9) + 2e-4 * lagged(warm, 10 * lag), rate_hz=10.0, temperature=warm)
    text = sentence(fit, "temperature")
    assert not {"cycle", "step"} & {finding.code for finding in fit.findings}
    assert float(text.partition("(")[2].split()[0]) == pytest.approx(2e-4, rel=0.2)
    assert ("with a lag of" in text) == bool(lag)
    if lag:
        assert float(text.partition("a lag of ")[2].split()[0]) == pytest.approx(60, rel=0.4)
    assert agrees_with_undisturbed(fit, noise(9))


def test_removed_disturbances_can_be_subtracted_from_the_samples() -> None:
    """The remainder is the noise to within 5 % of the disturbance, in any unit."""
    plain = noise(10)
    shape = 1e-3 * np.sin(2 * np.pi * 5.5 * np.arange(N) / N) + 2e-3 * (np.arange(N) > 40_000)
    for unit in (1.0, 1e-6):
        series = AxisSeries.from_samples(unit * (plain + shape), rate_hz=10.0)
        fit = fit_mle(series, allan_curve(series), FitSettings())
        assert [type(regressor) for regressor in fit.taken_out] == [Step, Wave, Wave]
        rest = without_disturbances(series, fit).samples / unit - plain
        assert np.std(rest) < 0.05 * np.std(shape)


def test_steps_and_cycles_are_found_across_gaps() -> None:
    """A record with a long gap has two blocks, which share the same cycle."""
    keep = np.ones(N, dtype=np.bool_)
    keep[25_000:27_000] = False
    samples = noise(11) + 1e-4 * np.sin(2 * np.pi * 6.7 * np.arange(N) / N) + 3e-4 * (np.arange(N) > 45_000)
    axis: Axis = "x"
    series = AxisSeries(
        sensor=Sensor.GYROSCOPE, axis=axis, samples=samples[keep], clock=Clock.even(N, 10.0).keeping(keep)
    )
    shapes = find_disturbances(make_blocks(series).blocks)[0]
    (step,), (cycle,) = with_shape(shapes, Step), with_shape(shapes, Wave)
    assert len(shapes) == 2
    assert step.shape.place == pytest.approx(45_000, abs=200)
    assert cycle.shape.frequency * N / (2 * np.pi) == pytest.approx(6.7, abs=0.1)


@pytest.mark.parametrize(
    "text", ["N=1e-4", TRUTH, "N=1e-4 + B=3e-5 + K=3e-6", "N=1e-4 + GM(sigma=4e-5, T=9)"]
)
def test_clean_noise_has_no_disturbances(text: str) -> None:
    """At most 1 of 6 records has one; of 100, at most 1 (`tests/benchmarks/disturbances.py clean`)."""
    assert sum(bool(found(simulated(text, 20_000, seed, rate_hz=10.0))) for seed in range(20, 26)) <= 1


def _blocks(seed: int) -> list[Block]:
    series = AxisSeries.from_samples(simulated("N=1 + K=1e-2", 4000, seed), rate_hz=1.0)
    return [block.lowest(1200) for block in make_blocks(series).blocks]


def test_gains_agree_with_generalised_least_squares() -> None:
    """The reference solves the normal equations of all regressors at the given spectrum."""
    blocks = _blocks(31)
    spectrum = 1 + 30 / (1 + np.arange(blocks[0].bins.size))
    known = (Ramp(), WarmUp(time_constant=900.0))
    tool = Whitened.by(blocks, spectrum, known)
    weight = 1 / np.repeat(spectrum, blocks[0].bins.count)

    def explained(columns: tuple[Regressor, ...]) -> float:
        matrix = np.stack([blocks[0].ordinates_of(column) for column in columns], axis=1)
        right = matrix.T @ (weight * blocks[0].ordinates)
        return float(right @ np.linalg.solve(matrix.T @ (weight[:, None] * matrix), right))

    for shape in ((Step(place=1234),), Wave.pair(0.01), (WarmUp(time_constant=80.0),)):
        expected = explained((*known, *shape)) - explained(known)
        assert tool.gain(shape) == pytest.approx(expected, rel=1e-8)


def test_the_search_for_a_step_finds_the_best_place() -> None:
    """No place that is tried one by one has a larger gain than the maximum of the sine transforms."""
    blocks = _blocks(32)
    tool = Whitened.by(blocks, np.ones(blocks[0].bins.size), (Ramp(),))
    place, gain, _ = tool.step()
    every = [tool.gain((Step(place=at),)) for at in range(30, 3970, 10)]
    assert gain >= max(every) - 1e-9
    between = Step(place=place)  # type: ignore[arg-type] # the closed form is defined between samples too
    assert gain == pytest.approx(tool.gain((between,)), rel=1e-6)


def test_the_search_for_cycles_needs_the_lowest_ordinates_only() -> None:
    """Gains from the lowest ordinates agree with gains from all ordinates to 1 %."""
    blocks = _blocks(33)
    tool = Whitened.by(blocks, 1 + 30 / (1 + np.arange(blocks[0].bins.size)), (Ramp(),))
    omega = 2 * np.pi * np.array([2.0, 7.7, 23.9]) / 4000
    every = [tool.gain(Wave.pair(w)) for w in omega.tolist()]
    assert tool.lowest().cycles(omega) == pytest.approx(every, rel=0.01, abs=0.02)


@pytest.mark.parametrize("shape", [0.0, 1.0, 2.0])
def test_the_false_alarm_rate_of_steps_is_the_chosen_level(shape: float) -> None:
    """The expected gain is the 90 % quantile of 200 draws, for white noise, flicker noise and a random walk.

    In white noise the best place moves in jumps, so the quantile is lower.
    """
    n, rng = 4000, np.random.default_rng(34)
    theta = np.pi * np.arange(1, n) / n
    spectrum = 1 + (0.2 / theta) ** shape
    bins = dct_bins(n, singles=n - 1)
    gains, choices = [], []
    for _ in range(200):
        block = Block(offset=0, bins=bins, ordinates=np.sqrt(spectrum) * rng.standard_normal(n - 1))
        low = block.lowest(1000)
        _, gain, choice = Whitened.by([low], spectrum[: low.bins.size], ()).step()
        gains.append(gain)
        choices.append(choice)
    expected = 2 * np.log(np.mean(choices) / 0.1)
    assert expected - 4 < np.quantile(gains, 0.9) < expected + 1.5


def test_a_weak_step_is_found_near_its_place() -> None:
    """Most records with a step of 1e-4 in 33 min of N = 1e-4, B = 1e-5, K = 1e-6 show it."""
    n, place = 200_000, 90_000
    model = NoiseModel.parse("N=1e-4 + B=1e-5 + K=1e-6")
    found: list[Disturbance[Step]] = []
    for seed in range(8):
        samples = model.simulate(n, rate_hz=100.0, rng=np.random.default_rng([35, seed]))
        samples = 1e4 * (samples + 1e-4 * (np.arange(n) >= place))
        block = Block(offset=0, bins=dct_bins(n), ordinates=dct_ordinates(samples))
        found += with_shape(find_disturbances([block])[0], Step)
    assert len(found) >= 4
    assert np.median([abs(one.shape.place - place) for one in found]) < 2000
    assert np.median([abs(one.size[0]) for one in found]) == pytest.approx(1.0, rel=0.3)


@pytest.mark.parametrize(
    ("height", "before", "seed"), [(1e-2, 0, 41), (1e-2, 1, 42), (1e-2, 8, 43), (1e-2, 30, 44)]
)
def test_no_step_is_removed_twice(height: float, before: int, seed: int) -> None:
    """A high step, alone or right after a dip, is reported once and at its sample."""
    samples = noise(seed)
    samples[21_337:] += height
    samples[21_337 - before : 21_337] -= height
    fit = fitted(samples, rate_hz=10.0)
    places = sorted(shape.place for shape in fit.taken_out if isinstance(shape, Step))
    assert places == sorted({21_337 - before, 21_337})
    (finding,) = [finding for finding in fit.findings if finding.code == "step"]
    assert finding.text.count(" at ") == len(places)
    assert agrees_with_undisturbed(fit, noise(seed))


#: Shapes without a random walk: warm-ups (time constant relative to the record) and slow cycles.
SLOW_SHAPES = {
    "strong warm-up of a third": 1e-3 * np.exp(-3 * T / T[-1]),
    "weak warm-up of a half": 3e-4 * np.exp(-2 * T / T[-1]),
    "warm-up of the whole record": 1e-3 * np.exp(-T / T[-1]),
    "one cycle": 2e-4 * np.cos(2 * np.pi * T / T[-1] + 0.4),
    "one and a half cycles": 2e-4 * np.cos(3 * np.pi * T / T[-1] + 1.9),
}


@pytest.mark.parametrize("name", SLOW_SHAPES)
def test_a_slow_shape_is_not_reported_as_a_random_walk(name: str) -> None:
    """Two records without a random walk report no K, and both report the warm-up or the cycle."""
    for seed in (50, 51):
        fit = fitted(noise(seed, "N=1e-4") + SLOW_SHAPES[name], rate_hz=10.0)
        assert fit["K"].value is None
        codes = {finding.code for finding in fit.findings}
        assert codes & {"warm-up-fitted", "warm-up-doubtful", "cycle", "cycle-doubtful", "level-doubtful"}


#: Changes of level by 2e-4 within minutes, without a random walk.
CHANGES = {
    "level": 1e-4 * (1 + np.tanh((T - 0.4 * T[-1]) / (0.08 * T[-1]))),
    "bump": 2e-4 * np.exp(-0.5 * ((T - 0.6 * T[-1]) / (0.08 * T[-1])) ** 2),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_of_level_is_named_and_k_may_be_zero(name: str) -> None:
    """The finding has the time of the change, in at least 3 of 4 records."""
    named, without = 0, 0
    for seed in range(80, 84):
        fit = fitted(noise(seed, "N=1e-4 + B=2e-5") + CHANGES[name], rate_hz=10.0)
        without += fit["K"].low == 0
        for finding in fit.findings:
            if finding.code == "level-doubtful":
                around = re.search(r"around (\S+) s", finding.text)
                assert around is not None
                place = 0.4 if name == "level" else 0.6
                named += abs(float(around[1]) / T[-1] - place) < 0.1
    assert named >= 3
    assert without >= 3


def test_a_change_of_level_that_is_likelier_than_a_walk_is_a_warning() -> None:
    """Twice the change in two thirds of the time is a warning in at least 3 of 4 records."""
    levels = []
    for seed in range(80, 84):
        change = 2e-4 * (1 + np.tanh((T - 0.4 * T[-1]) / (0.05 * T[-1])))
        fit = fitted(noise(seed, "N=1e-4 + B=2e-5") + change, rate_hz=10.0)
        levels += [finding.level for finding in fit.findings if finding.code == "level-doubtful"]
    assert levels.count("warning") >= 3


@pytest.mark.slow
def test_a_short_walk_that_resembles_a_change_of_level_is_no_warning() -> None:
    """Of 20 short records with a walk at most one has the warning, and some have the info."""
    levels = []
    for seed in range(20):
        samples = simulated("N=1.5e-4 + K=1.2e-5", 36_000, seed, rate_hz=50.0)
        fit = fitted(samples, rate_hz=50.0)
        levels += [finding.level for finding in fit.findings if finding.code == "level-doubtful"]
    assert levels.count("warning") <= 1
    assert "info" in levels


def test_a_random_walk_is_reported_despite_the_search_for_warm_ups() -> None:
    """At least 3 of 4 records with a random walk report K."""
    fits = [fitted(noise(seed, "N=1e-4 + K=4e-6"), rate_hz=10.0) for seed in range(60, 64)]
    assert sum(fit["K"].value is not None for fit in fits) >= 3


def test_the_finding_of_a_doubtful_warm_up_explains_both_readings() -> None:
    """The lower limit of K is zero, and the advice suggests `--skip`."""
    fit = fitted(noise(70, "N=1e-4") + SLOW_SHAPES["weak warm-up of a half"], rate_hz=10.0)
    (finding,) = [finding for finding in fit.findings if finding.code == "warm-up-doubtful"]
    assert "warm-up" in finding.text
    assert "random walk" in finding.text
    assert "--skip" in finding.advice
    assert fit["K"].low == 0


def test_gains_alone_agree_with_single_gains() -> None:
    """The gain of a regressor that the fit already contains is zero."""
    blocks = _blocks(36)
    tool = Whitened.by(blocks, 1 + 30 / (1 + np.arange(blocks[0].bins.size)), (Ramp(),))
    shapes = [WarmUp(time_constant=80.0), WarmUp(time_constant=900.0), Ramp()]
    alone = [tool.gain(shapes[:1]), tool.gain(shapes[1:2]), 0.0]
    assert tool.gains_alone(shapes) == pytest.approx(alone, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("shape", [LevelChange, Bump])
def test_gains_of_levels_agree_with_single_gains(shape: type[LevelChange] | type[Bump]) -> None:
    blocks = _blocks(37)
    tool = Whitened.by(blocks, 1 + 30 / (1 + np.arange(blocks[0].bins.size)), (Ramp(),))
    places = np.array([500.0, 2000.0, 9000.0])
    alone = [tool.gain((shape(place=place, width=300.0),)) for place in places.tolist()]
    assert tool.levels(shape, places, 300.0) == pytest.approx(alone, rel=1e-8, abs=1e-8)

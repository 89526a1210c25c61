"""Tests of the curve over temperature: kind, order and lag, its intervals, and the error in unseen parts."""

from dataclasses import replace

import numpy as np
import pytest

from imucal.temperature.curve import Kind
from imucal.temperature.fitting import Fit, Lags, cubic_of, curve_on, fit_axis, held_out
from imucal.temperature.ramp import AxisBlocks, Ramp
from tests.slow_cases import first_by_default
from tests.temperature.ramps import HALF, MIDDLE, SHAPES, SIZE, STATIC, KnownRamp, known_ramp

#: Curves whose value at every temperature is known, and that a polynomial describes.
SMOOTH = ("none", "line", "parabola", "cubic")


def fitted(known: KnownRamp) -> tuple[Ramp, AxisBlocks, Fit]:
    ramp = Ramp.of(known.recording)
    axis = AxisBlocks.of(known.recording.series[0], ramp)
    return ramp, axis, fit_axis(ramp, Lags.of(ramp), axis)


def error_in_a_new_log(known: KnownRamp, ramp: Ramp, fit: Fit, rng: np.random.Generator) -> float:
    """Return the rms error in a new log with the same effect and new slow noise, without its mean."""
    slow = known.model.simulate(known.bias.size, rate_hz=2.0, rng=rng)
    block = np.arange(slow.size) * ramp.blocks // slow.size
    means = np.bincount(block, weights=known.bias + slow) / np.bincount(block)
    rest = means - curve_on(fit.curve, ramp, np.arange(ramp.blocks))
    white = 1e-4**2 / ramp.block_s
    return float(np.sqrt(max(float(np.var(rest)) - white, white / ramp.blocks)))


def covered(shape: str, rng: np.random.Generator, noise: str, *, chamber: bool) -> np.ndarray:
    """Return whether the intervals of the change from the reference contain the true one."""
    _, _, fit = fitted(known_ramp(shape, rng, noise=noise, chamber=chamber))
    curve = fit.curve
    temperature = np.delete(np.linspace(curve.low_c, curve.high_c, 13), 6)

    def true(degrees: np.ndarray) -> np.ndarray:
        return SIZE * STATIC[shape]((degrees - MIDDLE) / HALF)

    reference = np.array([curve.reference_c])
    change = curve.static(temperature) - curve.static(reference)
    off = change - (true(temperature) - true(reference))
    return np.asarray(np.abs(off) <= curve.half_width(temperature) + 1e-15)


@pytest.mark.parametrize(
    ("shape", "kind", "lag_s"),
    [
        ("line behind 60 s", "lagged", 60.0),
        ("parabola behind 60 s", "lagged", 60.0),
        ("gradient of 200 s", "gradient", 200.0),
        ("gradient of 60 s", "gradient", 60.0),
    ],
)
def test_kind_and_lag_are_found(shape: str, kind: Kind, lag_s: float) -> None:
    """A line of the lagging temperature is a line with a gradient too, so both are right there."""
    _, _, fit = fitted(known_ramp(shape, np.random.default_rng(101), noise="N=1e-4 + K=1e-8"))
    assert fit.curve.kind == kind or "line" in shape or "200" in shape
    assert fit.curve.lag_s == pytest.approx(lag_s, rel=0.15)


def test_a_static_effect_has_no_lag() -> None:
    """A lag must divide the error by 1.6: in a slow walk the best of many lags rarely does so by chance."""
    rng = np.random.default_rng(102)
    kinds = [fitted(known_ramp(shape, rng))[2].curve.kind for shape in SMOOTH for _ in range(4)]
    assert kinds.count("present") >= 13


def test_a_walk_alone_gets_no_curve() -> None:
    """Slow noise is not an effect of temperature, in most logs."""
    rng = np.random.default_rng(103)
    orders = [fitted(known_ramp("none", rng))[2].curve.order for _ in range(12)]
    assert orders.count(0) >= 8


@pytest.mark.parametrize("shape", first_by_default(["cubic", "line"], 1))
def test_intervals_cover(shape: str) -> None:
    """A share below 0.9 of 24 logs has a probability below 1 %, as the temperatures of a log go together."""
    rng = np.random.default_rng(104)
    inside = [covered(shape, rng, "N=1e-4 + B=5e-5 + K=3e-7", chamber=k % 2 > 0) for k in range(24)]
    assert np.mean(inside) > 0.86


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["N=1e-4 + B=5e-5 + K=1e-6", "N=1e-4 + B=2e-5 + K=1e-7", "N=5e-4"])
def test_intervals_cover_all_smooth_shapes(noise: str) -> None:
    """95 % intervals of 120 logs: 30 of each shape, chambers and heaters."""
    rng = np.random.default_rng(105)
    inside = [covered(shape, rng, noise, chamber=k % 2 > 0) for shape in SMOOTH for k in range(30)]
    assert 0.92 < np.mean(inside) < 0.985


def test_the_error_in_unseen_parts_is_that_of_a_new_log() -> None:
    """The median over all shapes is within 30 % of the true one."""
    rng = np.random.default_rng(106)
    ratios = []
    for number, shape in enumerate([*SHAPES] * 2):
        known = known_ramp(shape, rng, chamber=number % 2 > 0)
        ramp, _, fit = fitted(known)
        assert fit.held_out is not None
        ratios.append(fit.held_out / error_in_a_new_log(known, ramp, fit, rng))
    assert np.median(ratios) == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_the_error_of_each_shape(shape: str) -> None:
    """The median of 24 logs of each shape is within 30 % of the true one."""
    rng = np.random.default_rng(107)
    ratios = []
    for number in range(24):
        known = known_ramp(shape, rng, chamber=number % 2 > 0)
        ramp, _, fit = fitted(known)
        assert fit.held_out is not None
        ratios.append(fit.held_out / error_in_a_new_log(known, ramp, fit, rng))
    assert np.median(ratios) == pytest.approx(1.0, abs=0.3)


def test_it_is_hardly_worse_than_a_cubic_and_often_better() -> None:
    """In unseen parts, for each shape: at most 5 % worse, and 2 times better if there is a strong lag."""
    rng = np.random.default_rng(108)
    for shape in SHAPES:
        known = known_ramp(shape, rng, noise="N=1e-4 + K=1e-7")
        ramp, axis, fit = fitted(known)
        cubic = held_out(ramp, Lags.of(ramp), axis, "present")[3]
        assert fit.held_out is not None
        assert fit.held_out < 1.05 * cubic
        if shape in {"line behind 60 s", "gradient of 200 s", "gradient of 60 s"}:
            assert fit.held_out < cubic / 2


def test_one_branch_has_no_lag_and_no_error() -> None:
    """A log that only heats can't tell a lag from another curve."""
    known = known_ramp("cubic", np.random.default_rng(109), noise="N=1e-5")
    half = known.recording.between(0.0, 1800.0)
    ramp = Ramp.of(half)
    axis = AxisBlocks.of(half.series[0], ramp)
    fit = fit_axis(ramp, Lags.of(ramp), axis)
    assert (fit.curve.kind, fit.curve.order, fit.held_out) == ("present", 3, None)
    u = np.linspace(-0.9, 0.9, 7)
    change = fit.curve.static(MIDDLE + HALF * u) - fit.curve.static(np.array([MIDDLE]))
    assert change == pytest.approx(SIZE * STATIC["cubic"](u), abs=2e-5)


def test_the_cubic_is_that_of_numpy() -> None:
    """The comparison is the least-squares cubic of flight stacks."""
    known = known_ramp("step", np.random.default_rng(110))
    ramp = Ramp.of(known.recording)
    axis = AxisBlocks.of(known.recording.series[0], ramp)
    temperature = ramp.temperature[axis.places]
    reference = np.polyval(np.polyfit(temperature, axis.means, 3), temperature)
    assert cubic_of(ramp, axis, 3).static(temperature) == pytest.approx(reference, abs=1e-9)


def test_outside_the_range_the_ends_are_used() -> None:
    """An extrapolated cubic would leave the bias far behind."""
    curve = fitted(known_ramp("cubic", np.random.default_rng(111)))[2].curve
    outside = curve.static(np.array([-80.0, 200.0]))
    assert outside.tolist() == curve.static(np.array([curve.low_c, curve.high_c])).tolist()


def test_outliers_and_gaps_are_left_out() -> None:
    """Single wild samples and lost minutes change nothing but the blocks that they were in."""
    known = known_ramp("cubic", np.random.default_rng(112), noise="N=1e-4")
    series = known.recording.series[0]
    samples = series.samples.copy()
    samples[::500] += 0.5
    keep = np.ones(samples.size, dtype=np.bool_)
    keep[2000:2300] = False
    other = replace(known.recording, series=(replace(series, samples=samples).keeping(keep),))
    ramp = Ramp.of(other)
    axis = AxisBlocks.of(other.series[0], ramp)
    fit = fit_axis(ramp, Lags.of(ramp), axis)
    assert ramp.blocks - 9 <= axis.places.size <= ramp.blocks - 7
    u = np.linspace(-0.9, 0.9, 7)
    change = fit.curve.static(MIDDLE + HALF * u) - fit.curve.static(np.array([MIDDLE]))
    assert change == pytest.approx(SIZE * STATIC["cubic"](u), abs=6e-5)

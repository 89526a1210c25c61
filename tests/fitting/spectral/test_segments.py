"""Tests of the segments of a record: ordinates, the likelihood of their scales, and the fit's findings."""

import numpy as np
import numpy.testing as npt
import pytest
from scipy.optimize import minimize

import imucal
from imucal.clock import Clock
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.regressors import Ramp, Regressor, Step, TemperatureEffect, WarmUp, Wave
from imucal.fitting.spectral import mle
from imucal.fitting.spectral.blocks import make_blocks
from imucal.fitting.spectral.common_terms import Parts
from imucal.fitting.spectral.disturbances.band import Band
from imucal.fitting.spectral.disturbances.segments import (
    SegmentOrdinates,
    number_of_segments,
    segment_ordinates,
)
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries, Sensor
from tests.fitting.fits import fitted, simulated

RATE_HZ = 100.0
#: Eight segments of a length with a fast transform, so that no segment is shortened.
N = 8 * 4096
FLAT = Band()


def axis(samples: np.ndarray, keep: np.ndarray | None = None) -> AxisSeries:
    """Return an axis at 100 Hz with the kept samples only."""
    series = AxisSeries.from_samples(samples, rate_hz=RATE_HZ)
    return series if keep is None else series.keeping(keep)


def cut(
    series: AxisSeries, drift: dict[Regressor, float] | None = None, temperature: np.ndarray | None = None
) -> SegmentOrdinates | None:
    """Return the ordinates of eight segments of a series over the whole band."""
    blocks = make_blocks(series, temperature)
    return segment_ordinates(series, blocks, drift=drift or {}, wanted=8, band=FLAT)


def white_levels(found: SegmentOrdinates | None, series: AxisSeries) -> np.ndarray:
    """Return the mean square of the ordinates of each segment, in the samples' unit."""
    assert found is not None
    ordinates = found.ordinates
    mean = np.add.reduceat(ordinates.power, found.first) / np.add.reduceat(ordinates.size, found.first)
    return np.asarray(mean * make_blocks(series).scale ** 2)


def fit(samples: np.ndarray | AxisSeries, *, segments: int = 8, model: str = "auto") -> NoiseFit:
    """Return the fit of samples at 100 Hz."""
    series = samples if isinstance(samples, AxisSeries) else axis(samples)
    return imucal.fit(series, model=model, segments=segments)


@pytest.mark.parametrize(
    ("samples", "wanted", "count"),
    [(1_000_000, 8, 8), (10_000, 8, 4), (6143, 8, 0), (6144, 8, 3), (4096, 2, 2), (9999, 1, 0), (99, 8, 0)],
)
def test_short_records_have_fewer_segments_or_none(samples: int, wanted: int, count: int) -> None:
    """A segment has at least 2048 samples; if more than two are requested, at least three are needed."""
    assert number_of_segments(samples, wanted) == count


def test_segments_have_the_power_of_their_samples() -> None:
    """The mean square of each of eight noise levels equals the variance about the segment's mean."""
    rng = np.random.default_rng(31)
    parts = [scale * rng.standard_normal(N // 8) for scale in (1, 2, 3, 4, 5, 6, 7, 8)]
    series = axis(np.concatenate(parts))
    npt.assert_allclose(white_levels(cut(series), series), [part.var(ddof=1) for part in parts], rtol=1e-9)


def test_segments_divide_the_record_evenly() -> None:
    found = cut(axis(np.random.default_rng(32).standard_normal(N)))
    assert found is not None
    npt.assert_allclose(found.start_s, np.arange(8) * N / 8 / RATE_HZ)
    npt.assert_allclose(found.end_s, np.arange(1, 9) * N / 8 / RATE_HZ)


def test_disturbances_are_removed_from_the_segments() -> None:
    """Only the noise remains after a ramp, a warm-up, a step, a cycle and a lagging temperature."""
    rng = np.random.default_rng(33)
    noise = rng.standard_normal(N)
    t, heat = np.arange(N, dtype=np.float64), np.cumsum(rng.standard_normal(N)) / 30
    shapes = {
        Ramp(): 1e-3,
        WarmUp(time_constant=5000.0): 40.0,
        Step(place=9000): 3.0,
        Wave(frequency=0.002): 2.0,
        TemperatureEffect(lag=300.0): 2.0,
    }
    slow = sum(size * shape.samples(t, heat) for shape, size in shapes.items())
    series = axis(noise + slow)
    scale = make_blocks(series).scale
    found = cut(series, {shape: size / scale for shape, size in shapes.items()}, heat)
    expected = [part.var(ddof=1) for part in np.split(noise, 8)]
    npt.assert_allclose(white_levels(found, series), expected, rtol=1e-6)


def test_a_segment_inside_a_long_gap_is_omitted() -> None:
    """The times of the other segments do not change."""
    keep = np.ones(N, dtype=bool)
    keep[N // 4 - 100 : 3 * N // 8 + 100] = False
    found = cut(axis(np.random.default_rng(34).standard_normal(N), keep))
    assert found is not None
    npt.assert_allclose(found.start_s / (N / 8 / RATE_HZ), [0, 1, 3, 4, 5, 6, 7])


def test_short_gaps_do_not_bias_the_level() -> None:
    """White noise has the same variance in all segments if a tenth of the samples is missing in one half."""
    rng = np.random.default_rng(35)
    keep = np.ones(N, dtype=bool)
    keep[: N // 2] = rng.random(N // 2) > 0.1
    series = axis(rng.standard_normal(N), keep)
    found = cut(series)
    assert found is not None
    # Four standard errors of a mean square of 4096.
    npt.assert_allclose(white_levels(found, series), np.ones(8), atol=4 * np.sqrt(2 / 3600))
    total = np.add.reduceat(found.ordinates.size, found.first)
    npt.assert_allclose(total[:4], 0.9**2 * 4095, rtol=0.03)
    npt.assert_allclose(total[4:], 4095)


def test_spectral_lines_are_excluded_from_the_segments() -> None:
    """A tone with the power of the noise leaves the level of every segment at 1."""
    rng = np.random.default_rng(36)
    tone = 1.4 * np.sin(2 * np.pi * 17.3 / RATE_HZ * np.arange(N))
    series = axis(rng.standard_normal(N) + tone)
    npt.assert_allclose(white_levels(cut(series), series), np.ones(8), atol=4 * np.sqrt(2 / 4000))


def parts(power: np.ndarray, *, size: float = 30.0) -> Parts:
    """Return two tests of segments of 40 bins: of a flat part next to a steep one, and vice versa."""
    steep = np.tile(1 / np.linspace(0.1, 3, 40) ** 2, power.size // 40)
    flat, nothing = np.ones(power.size), np.zeros(power.size)
    return Parts(
        ordinates=Ordinates(
            scale=1.0, size=np.full(power.size, size), power=power, lam=flat, length=flat, sign=nothing,
            basis=flat[None], regressors=(), cross=np.zeros((0, power.size)),
            gram=np.zeros((0, 0, power.size)),
        ),
        regressors=np.zeros(0, dtype=bool),
        first=np.arange(0, power.size, 40),
        varied=np.array([[flat, steep], [steep, flat]]),
        held=np.full((2, power.size), 0.05),
    )  # fmt: skip


def power_of(rng: np.random.Generator, levels: np.ndarray, *, size: float = 30.0) -> np.ndarray:
    """Return segments of squares: a white level each, a steep part and a small constant part."""
    spectrum = 0.05 + np.repeat(levels, 40) + np.tile(1 / np.linspace(0.1, 3, 40) ** 2, levels.size)
    return np.asarray(spectrum * rng.chisquare(size, spectrum.size))


def objective(of: Parts, test: int, logs: np.ndarray) -> float:
    """Return -log L of logarithmic scales of shape (g, 2), computed bin by bin."""
    total = 0.0
    for i, (size, power) in enumerate(zip(of.ordinates.size, of.ordinates.power, strict=True)):
        s = of.held[test, i] + np.exp(logs[i // 40]) @ of.varied[test, :, i]
        total += 0.5 * (size * np.log(s) + power / s)
    return total


@pytest.mark.parametrize("common", [False, True])
def test_scales_maximise_the_likelihood(*, common: bool) -> None:
    """The reference is BFGS on the likelihood computed bin by bin."""
    of = parts(power_of(np.random.default_rng(37), np.array([0.7, 1.0, 3.0])))
    found = of.fit(common=common)
    for test in range(2):

        def unpacked(theta: np.ndarray) -> np.ndarray:
            return np.stack([np.full(3, theta[0]) if common else theta[:3], theta[-3:]], axis=1)

        def cost(theta: np.ndarray, test: int = test) -> float:
            return objective(of, test, unpacked(theta))

        witness = minimize(cost, np.zeros(4 if common else 6), method="BFGS", options={"gtol": 1e-4})
        assert found.objective[test].sum() == pytest.approx(objective(of, test, found.logs[test]))
        assert found.objective[test].sum() == pytest.approx(witness.fun, abs=1e-4)
        npt.assert_allclose(found.logs[test], unpacked(witness.x), atol=2e-3)


def test_information_accounts_for_the_unknown_other_part() -> None:
    """The reference inverts the diagonal of the inverse 2 x 2 information at the expected power."""
    of = parts(power_of(np.random.default_rng(38), np.array([1.0, 1.0])))
    a, b = (of.varied[0] / (of.held[0] + of.varied[0].sum(axis=0)))[:, :40]
    matrix = 15.0 * np.array([[a @ a, a @ b], [a @ b, b @ b]])
    information = of.at(np.zeros((2, 2, 2))).information
    npt.assert_allclose(information[0], 1 / np.linalg.inv(matrix)[0, 0], rtol=1e-8)


@pytest.mark.parametrize("steep", [1.0, 0.02, 0.0])
def test_limits_of_a_sum_are_its_extremes_in_the_likelihood_region(steep: float) -> None:
    """The reference is a dense grid of all pairs of scales; one of the parts may be zero."""
    rng = np.random.default_rng(43)
    spectrum = 1.05 + steep / np.linspace(0.1, 3, 40) ** 2
    of = parts(np.concatenate([spectrum * rng.chisquare(3.0, 40) for _ in range(2)]), size=3.0).of(0)
    best = of.fit(common=False)
    weights, reach = np.array([0.3, 0.2]), np.array([1.96, 2.2])
    value, low, high = of.sum_limits(best.logs[0], weights, reach)
    first, second = np.meshgrid(np.linspace(-1.5, 1.5, 301), 2 * np.log(np.linspace(1e-3, 2, 400)))
    logs = np.stack([first.ravel(), second.ravel()], axis=-1)[:, np.newaxis].repeat(2, axis=1)
    allowed = 2 * (of.at(logs).objective - best.objective) < reach**2
    sums = np.exp(logs) @ weights
    npt.assert_allclose(value, np.exp(best.logs[0]) @ weights)
    npt.assert_allclose(low, np.where(allowed, sums, np.inf).min(axis=0), rtol=0.02)
    npt.assert_allclose(high, np.where(allowed, sums, -np.inf).max(axis=0), rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("text", "rate"), [("N=1e-4 + B=1e-4 + K=2e-5", 10.0), ("N=1e-4 + B=3e-5", 10.0)])
def test_intervals_of_the_segments_floors_cover_the_true_floor(text: str, rate: float) -> None:
    """Coverage is 93 to 99 % (`tests/benchmarks/coverage_auto.py`); errors of one record are correlated."""
    held: list[bool] = []
    truth = NoiseModel.parse(text)
    for seed in range(12):
        found = fitted(simulated(text, 20_000, 500 + seed, rate_hz=rate), rate_hz=rate).segments
        if found is not None and found.floor is not None:
            true = np.sqrt(truth.avar(np.array([found.floor_tau_s * rate]), rate_hz=rate))
            held += ((found.floor.low <= true) & (true <= found.floor.high)).tolist()
    assert len(held) >= 80
    assert np.mean(held) >= 0.85


def test_the_order_of_segments_does_not_matter() -> None:
    """Permuted segments have the same scales and likelihood."""
    power = power_of(np.random.default_rng(39), np.array([0.7, 1.0, 3.0, 1.5]))
    order = np.array([2, 0, 3, 1])
    of, shuffled = parts(power), parts(power.reshape(4, 40)[order].ravel())
    npt.assert_allclose(
        of.fit(common=False).logs[:, order], shuffled.fit(common=False).logs, rtol=1e-6, atol=1e-9
    )
    one, other = (p.fit(common=True).objective.sum(axis=1) for p in (of, shuffled))
    npt.assert_allclose(one, other, rtol=1e-12)


def test_an_absent_part_does_not_stop_the_search() -> None:
    """The scale of a part that the data do not contain tends to zero, and the other scale is found."""
    found = parts(1.05 * np.random.default_rng(40).chisquare(30, 80)).fit(common=False)
    # Four standard errors of 1200 degrees of freedom.
    npt.assert_allclose(np.exp(found.logs[0, :, 0]), 1.0, atol=4 * np.sqrt(2 / 1200) + 0.05)
    assert np.all(found.logs[0, :, 1] < -3)


def test_a_stationary_record_has_no_finding() -> None:
    """No interval is widened, and the segments' N agrees with the record's N within four standard errors."""
    found = fit(simulated("N=1 + B=0.3", N, 41, rate_hz=RATE_HZ))
    assert found.segments is not None
    assert not found.segments.changing
    assert "nonstationary" not in {finding.code for finding in found.findings}
    assert {e.widening for e in found.estimates} == {1.0}
    white, n = found.segments.white, found["N"].value
    assert white is not None
    assert n is not None
    npt.assert_allclose(white.value, n, rtol=4 * np.sqrt(0.5 / 4096))
    npt.assert_allclose(np.log(white.high / white.low) / 2, 1.96 * np.sqrt(0.5 / 4096), rtol=0.25)


def test_a_jump_of_the_noise_is_found_and_widens_the_interval() -> None:
    """White noise is four times as large in the second half; only N is widened, both halves are named."""
    samples = simulated("N=0.001", N, 42, rate_hz=RATE_HZ) * np.where(np.arange(N) < N // 2, 1.0, 4.0)
    samples += simulated("B=0.0003", N, 43, rate_hz=RATE_HZ)
    found = fit(samples)
    assert found.segments is not None
    assert found.segments["N"].factor > 5
    assert found.segments["B"].factor == found.segments["K"].factor == 1.0
    # Standard deviation of eight logarithms, the halves of which differ by a factor of 4.
    assert found.segments["N"].spread == pytest.approx(np.log(4) / 2 * np.sqrt(8 / 7), rel=0.1)
    assert found.segments["N"].lowest_s[1] <= N / 2 / RATE_HZ <= found.segments["N"].highest_s[0]
    (warning,) = (f for f in found.findings if f.code == "nonstationary")
    assert warning.level == "warning"
    once = fit(samples, segments=1)
    assert once["N"].low > found["N"].low
    assert once["N"].high < found["N"].high
    ratio = np.log(found["N"].high / found["N"].low) / np.log(once["N"].high / once["N"].low)
    assert ratio == pytest.approx(found["N"].widening / once["N"].widening, rel=1e-6)
    assert found["N"].widening == found.segments["N"].factor


def test_n_is_the_mean_level_of_noise_that_swings_within_the_segments() -> None:
    """The level swings by 50 % with a period of 10 or 20 s, several times per segment."""
    for seed, period_s in enumerate((10.0, 20.0)):
        swing = 1 + 0.5 * np.sin(2 * np.pi * np.arange(N) / RATE_HZ / period_s)
        found = fit(simulated("N=0.001", N, 44 + seed, rate_hz=RATE_HZ) * swing)
        assert found["N"].low <= 0.001 * np.sqrt(1 + 0.5**2 / 2) <= found["N"].high


def test_a_change_of_slow_noise_does_not_widen_white_noise() -> None:
    """The flicker noise is five times as large in one half."""
    slow = simulated("B=0.0005", N, 45, rate_hz=RATE_HZ) * np.where(np.arange(N) < N // 2, 1.0, 5.0)
    found = fit(simulated("N=0.001", N, 46, rate_hz=RATE_HZ) + slow, model="N + B")
    assert found.segments is not None
    assert found.segments["B"].factor > 2
    assert found.segments["N"].factor == 1.0
    assert found["K"].widening == found["B"].widening > 2
    assert found["N"].widening == 1.0


def test_one_segment_disables_the_test() -> None:
    """There is neither a finding nor a wider interval."""
    samples = simulated("N=1", N, 47) * np.where(np.arange(N) < N // 2, 1.0, 4.0)
    found = fit(samples, segments=1)
    assert found.segments is None
    assert "nonstationary" not in {finding.code for finding in found.findings}


def test_a_short_record_has_no_segments_and_no_finding() -> None:
    """A fit of 4000 samples is the same as with one segment."""
    samples = simulated("N=1 + K=0.1", 4000, 48)
    found, once = fit(samples), fit(samples, segments=1)
    assert found.segments is None
    assert found.findings == once.findings
    assert found.estimates == once.estimates


def test_the_unit_of_the_samples_does_not_matter() -> None:
    """Scaling by a power of two is exact: every Q stays the same and N scales."""
    samples = simulated("N=1 + B=0.5", N, 49, rate_hz=RATE_HZ)
    one, other = fit(samples).segments, fit(samples * 2.0**-20).segments
    assert one is not None
    assert other is not None
    assert [t.statistic for t in one.terms] == pytest.approx([t.statistic for t in other.terms], rel=1e-6)
    assert one.white is not None
    assert other.white is not None
    npt.assert_allclose(one.white.value, other.white.value * 2.0**20, rtol=1e-9)


def test_segments_of_white_noise_in_another_order_have_the_same_q() -> None:
    """The segments have the same N; only the record's own fit changes slightly."""
    parts = np.split(np.random.default_rng(50).standard_normal(N), 8)
    one = fit(np.concatenate(parts), model="N").segments
    other = fit(np.concatenate([parts[i] for i in (3, 0, 7, 1, 6, 2, 5, 4)]), model="N").segments
    assert one is not None
    assert other is not None
    assert one["N"].statistic == pytest.approx(other["N"].statistic, rel=0.02)


def test_heavy_tails_are_not_reported_as_a_change() -> None:
    """The mean squares of Student's t with 5 degrees of freedom vary more, and the test allows for it."""
    found = [fit(np.random.default_rng([51, i]).standard_t(5, N), model="N").segments for i in range(6)]
    assert sum(s is not None and bool(s.changing) for s in found) <= 1


def test_a_stationary_record_with_gaps_has_no_finding() -> None:
    """An accelerometer's record with long and short gaps has eight segments."""
    rng = np.random.default_rng(52)
    keep = rng.random(N) > 0.02
    keep[9000:9600] = False
    clock = Clock.even(N, RATE_HZ)
    samples = simulated("N=0.01 + B=0.003", N, 53, rate_hz=RATE_HZ)
    series = AxisSeries(sensor=Sensor.ACCELEROMETER, axis="z", samples=samples, clock=clock).keeping(keep)
    found = fit(series)
    assert found.segments is not None
    assert found.segments.start_s.size == 8
    assert not found.segments.changing


def test_stationary_records_are_rarely_widened() -> None:
    """At most 2 of 12 records of three truths are (0.6 are expected at 5 %; 3 have a probability of 2 %)."""
    truths = ("N=1e-3", "N=1e-3 + B=4e-4", "N=1e-3 + K=1e-4")
    wider = 0
    for i in range(12):
        truth = truths[i % 3]
        found = fit(simulated(truth, N, 5400 + i, rate_hz=RATE_HZ), model="N + B + K" if i % 3 else "N")
        wider += any(e.widening > 1 for e in found.estimates)
    assert wider <= 2


def test_a_failed_comparison_of_segments_keeps_the_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimates equal those of a fit with one segment, and a finding contains the error."""

    def failing(*_: object, **__: object) -> None:
        msg = "no"
        raise np.linalg.LinAlgError(msg)

    samples = simulated("N=1", N, 55)
    once = fit(samples, segments=1, model="N")
    monkeypatch.setattr(mle, "fit_segments", failing)
    found = fit(samples, model="N")
    assert found.segments is None
    assert found.estimates == once.estimates
    (warning,) = (f for f in found.findings if f.code == "nonstationary")
    assert (
        warning.text == "The parts of the record are not compared: the calculation failed (LinAlgError: no)."
    )

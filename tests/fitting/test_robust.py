"""Tests of the detection of spikes and of rounding."""

from dataclasses import replace
from unittest import mock

import numpy as np
import numpy.testing as npt
import pytest
from numpy.typing import NDArray
from scipy.special import ndtri

from imucal.arrays import FloatArray
from imucal.fitting import fit
from imucal.fitting.robust import (
    _baseline,
    _medians,
    clean,
    find_spikes,
    resolution_effect,
    step_size,
    without_torn_reads,
)
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries


def _series(samples: FloatArray) -> AxisSeries:
    return AxisSeries.from_samples(samples, rate_hz=100.0)


def spikes(samples: FloatArray) -> NDArray[np.bool_]:
    """Return the mask of the spikes."""
    return find_spikes(samples)[0]


def _noise(n: int, seed: int) -> FloatArray:
    return NoiseModel.parse("N=0.1 + K=1e-2").simulate(n, rate_hz=100.0, rng=np.random.default_rng(seed))


def test_clean_data_is_returned_unchanged() -> None:
    """The result is the same object, and there is no finding."""
    series = _series(_noise(100_000, 1))
    same, findings = clean(series)
    assert same is series
    assert findings == ()


def test_gaussian_noise_has_no_spikes() -> None:
    """The false alarm rate is 1 %; more than 8 of 200 records is beyond three standard errors."""
    rng = np.random.default_rng(2)
    assert sum(bool(spikes(rng.standard_normal(5000)).any()) for _ in range(200)) <= 8


@pytest.mark.parametrize(("share", "size"), [(1e-3, 10), (1e-3, 100), (1e-2, 10), (1e-2, 100), (5e-2, 10)])
def test_cleaning_restores_the_white_noise(share: float, size: float) -> None:
    """Its deviation is right to 1 % after cleaning; the spikes had raised it up to tenfold."""
    rng = np.random.default_rng(3)
    samples = _noise(200_000, 4)
    hit = rng.random(samples.size) < share
    spoiled = samples + size * hit * rng.choice([-1.0, 1.0], samples.size)
    cleaned, findings = clean(_series(spoiled))
    assert np.diff(cleaned.samples).std() == pytest.approx(np.diff(samples).std(), rel=0.01)
    assert spikes(spoiled).sum() == pytest.approx(hit.sum(), abs=2)
    npt.assert_array_equal(cleaned.samples[~hit & ~spikes(spoiled)], samples[~hit & ~spikes(spoiled)])
    assert [finding.code for finding in findings] == ["spikes"]


def test_spikes_are_measured_from_the_baseline_not_from_zero() -> None:
    """The same samples are spikes whether the axis measures gravity or not."""
    samples = _noise(5_000, 8)
    samples[[70, 4000]] += 30.0
    for level in (0.0, 9.8, -9.8):
        assert np.flatnonzero(spikes(samples + level)).tolist() == [70, 4000]


def test_the_finding_of_spikes_is_a_warning_above_one_per_cent() -> None:
    """It contains the count, the share and the largest spike."""
    samples = np.random.default_rng(5).standard_normal(10_000)
    samples[1234] += 50
    _, (finding,) = clean(_series(samples))
    assert finding.level == "info"
    assert finding.axis == "gyro_x"
    assert finding.text.startswith("1 spike was replaced (0.01 % of the samples), the largest ")
    samples[::50] += 50
    _, (finding,) = clean(_series(samples))
    assert finding.level == "warning"
    assert finding.text.startswith("201 spikes were replaced (2 % of the samples), the largest ")
    assert finding.advice == "Look for loose wiring, a shared bus or a moving sensor."


def test_cleaning_is_deterministic() -> None:
    """The noise that replaces spikes is drawn with a fixed seed."""
    samples = _noise(10_000, 6)
    samples[::500] += 30
    npt.assert_array_equal(clean(_series(samples))[0].samples, clean(_series(samples))[0].samples)


@pytest.mark.parametrize("samples", [np.zeros(1000), np.arange(5.0), np.zeros(0), np.ones(1)])
def test_constant_or_few_samples_have_no_spikes(samples: FloatArray) -> None:
    assert not spikes(samples).any()


def test_a_coarse_resolution_step_is_not_a_spike() -> None:
    """Most samples have the same value after rounding to four standard deviations; a real spike is found."""
    samples = np.round(np.random.default_rng(7).standard_normal(20_000) / 4) * 4
    assert not spikes(samples).any()
    samples[100] = 400
    assert spikes(samples).sum() == 1


def test_cleaning_sorts_only_outliers() -> None:
    """Medians of blocks need a partition of the samples for the distances and one for the baseline."""
    samples = np.random.default_rng(8).standard_normal(100_000)
    samples[50_000] = 20
    with (
        mock.patch.object(np, "partition", wraps=np.partition) as partition,
        mock.patch.object(np, "sort", wraps=np.sort) as sort,
    ):
        clean(_series(samples))
    assert sum(call.args[0].size for call in partition.call_args_list) <= 2 * samples.size
    assert sum(call.args[0].size for call in sort.call_args_list) < samples.size / 100


@pytest.mark.parametrize("step", [0.25, 1.0, 1.5])
def test_the_step_of_rounded_samples_is_found(step: float) -> None:
    """It is also found with an offset in single precision; samples that are not rounded have none."""
    samples = np.round(np.random.default_rng(9).standard_normal(50_000) / step) * step
    assert step_size(samples) == pytest.approx(step)
    single = (samples + 9.8).astype(np.float32).astype(np.float64)
    assert step_size(single) == pytest.approx(step, rel=1e-5)
    assert step_size(np.random.default_rng(9).standard_normal(50_000)) is None


@pytest.mark.parametrize(("step", "known"), [(0.5, True), (1.0, True), (1.6, True), (5.0, False)])
def test_the_contribution_of_rounding_to_n_is_subtracted(step: float, *, known: bool) -> None:
    """N² - LSB² tau0 / 12 is the sensor's N² to 2 % for steps up to LSB = 1.6 sigma (Sheppard)."""
    samples = np.round(np.random.default_rng(10).standard_normal(200_000) / step) * step
    (finding,) = resolution_effect(_series(samples), float(samples.std()) / 10)
    assert finding.code == "rounding"
    if not known:
        assert finding.level == "warning"
        assert "is mostly rounding; the sensor's own N is unknown" in finding.text
        return
    assert finding.level == "info"
    corrected = float(finding.text.rpartition("N = ")[2].split()[0])
    assert corrected == pytest.approx(0.1, rel=0.02)


def test_fine_steps_have_no_finding() -> None:
    """A step of a quarter of the noise adds half a per cent to N²."""
    samples = np.round(np.random.default_rng(11).standard_normal(50_000) * 4) / 4
    assert resolution_effect(_series(samples), 0.1) == ()


def test_the_finding_of_rounding_uses_the_unit_of_the_sensor() -> None:
    series = _series(np.round(np.random.default_rng(12).standard_normal(100_000)))
    series = replace(series, sensor=type(series.sensor)("accelerometer"))
    (finding,) = resolution_effect(series, 0.1041)
    assert finding.text == (
        "Samples come in steps of 1 m/s², 0.96 times their noise. Rounding is 3.9 % of "
        "N = 0.1041; without it N = 0.1 m/s²/√Hz."
    )


def test_the_baseline_interpolates_medians_and_is_constant_at_the_ends() -> None:
    """Blocks of 100 samples at 0, 10 and 30, the last with 50 more, have constant ends of half a block."""
    samples = np.repeat([0.0, 10.0, 30.0, 99.0], [100, 100, 100, 50])
    baseline = _baseline(samples)
    expected = np.interp(np.arange(350), [49.5, 149.5, 249.5], [0.0, 10.0, 30.0])
    npt.assert_allclose(baseline, expected, atol=1e-12)
    npt.assert_array_equal(_baseline(np.array([1.0, 5.0, 2.0])), 2.0)


@pytest.mark.parametrize(("size", "found"), [(19, 0), (20, 1)])
def test_spikes_need_at_least_twenty_samples(size: int, found: int) -> None:
    """Fewer samples have no spikes, however large one is."""
    samples = np.random.default_rng(13).standard_normal(size)
    samples[7] = 1e3
    assert spikes(samples).sum() == found


def test_more_than_one_per_cent_of_spikes_is_a_warning() -> None:
    """The finding contains the largest spike in standard deviations, to four digits."""
    samples = np.random.default_rng(14).standard_normal(10_000)
    samples[::100] = 1e3
    _, (finding,) = clean(_series(samples))
    assert finding.level == "info"
    samples[50] = 1e3
    _, (finding,) = clean(_series(samples))
    assert finding.level == "warning"
    samples[50] = 1e6
    _, (finding,) = clean(_series(samples))
    assert finding.text.endswith(", the largest 1e+06 rad/s, over 10000 standard deviations.")


@pytest.mark.parametrize(
    ("white", "level"), [(0.21, None), (0.2, "info"), (0.0501, "info"), (0.0499, "warning"), (0.0, None)]
)
def test_rounding_is_reported_from_two_per_cent_and_hides_noise_below_half_a_step(
    white: float, level: str | None
) -> None:
    """Steps of 1 at 100 Hz: 1/1200 is 2.08 % of 0.2² and 1.89 % of 0.21²; N = 0.05 is half a step."""
    samples = np.round(3 * np.random.default_rng(15).standard_normal(1000))
    assert [f.level for f in resolution_effect(_series(samples), white)] == ([level] if level else [])


@pytest.mark.parametrize(("off", "step"), [(0.0, 1e-3), (1e-10, 1e-3), (1e-5, None)])
def test_a_grid_tolerates_a_millionth_of_its_step_or_single_precision(off: float, step: float | None) -> None:
    """The rounding error of values up to 0.05 in single precision is 2.4e-8."""
    samples = 1e-3 * np.repeat(np.arange(50.0), 4)
    samples[-4:] += off
    found = step_size(samples)
    assert found == (None if step is None else pytest.approx(step))


@pytest.mark.parametrize(("copies", "found"), [(3, False), (4, True)])
def test_a_grid_has_values_that_occur_four_times_on_average(copies: int, *, found: bool) -> None:
    """It also has at least three different values."""
    assert (step_size(np.repeat(np.arange(3.0), copies)) is not None) == found
    assert step_size(np.repeat(np.arange(2.0), copies)) is None


def test_fewer_than_twenty_samples_are_unchanged() -> None:
    """They have neither a baseline nor a deviation."""
    samples = np.array([0.0, 1.0, 50.0] * 6)
    spike, baseline, deviation = find_spikes(samples)
    assert not spike.any()
    assert baseline is samples
    assert deviation == 0.0


@pytest.mark.parametrize("draw", ["standard_t", "laplace"])
@pytest.mark.parametrize("n", [20_000, 200_000])
def test_heavy_tails_are_not_spikes(draw: str, n: int) -> None:
    """Student's t with 4 degrees of freedom and Laplace noise keep their samples; an added spike is found."""
    rng = np.random.default_rng(14)
    samples = rng.standard_t(4, n) if draw == "standard_t" else rng.laplace(size=n)
    assert spikes(samples).sum() <= 2
    samples[777] = 500.0
    assert spikes(samples)[777]


def test_tails_without_a_variance_are_cut() -> None:
    """Student's t with 2 degrees of freedom has no variance to estimate."""
    samples = np.random.default_rng(15).standard_t(2, 100_000)
    assert 0.001 < spikes(samples).mean() < 0.05


def test_heavy_tails_do_not_bias_n() -> None:
    """The mean N of 6 records is right to three standard errors, and most intervals cover it."""
    rng = np.random.default_rng(16)
    truth = np.sqrt(2.0)
    fits = [fit(_series(rng.standard_t(4, 50_000) * 10.0), model="N")["N"] for _ in range(6)]
    values = np.array([found.value for found in fits], dtype=np.float64)
    assert values.mean() == pytest.approx(truth, rel=3 * 0.015)
    assert sum(found.low < truth < found.high for found in fits) >= 4


@pytest.mark.parametrize("spike", [4.0, 5.9, 6.3, 7.0, 40.0])
@pytest.mark.parametrize("n", [1234, 60_000])
def test_the_median_is_skipped_if_a_count_excludes_spikes(
    spike: float, n: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same samples are spikes as with the median of all distances."""
    samples = _noise(n, 21)
    samples[n // 3] = _baseline(samples)[n // 3] + spike
    distance = np.abs(samples - _baseline(samples))
    deviation = 1.4826 * np.median(distance)
    reach = max(5.0, -float(ndtri(0.01 / (2 * n))))
    plain = distance.max() <= reach * deviation
    if plain:
        monkeypatch.setattr(np, "median", None)
    assert spikes(samples).any() == (not plain)


@pytest.mark.parametrize("block", [2, 3, 100, 101])
def test_medians_of_blocks_agree_with_numpy(block: int) -> None:
    """They are exact for odd and even block lengths, also with many equal samples."""
    rng = np.random.default_rng(22)
    for samples in (rng.standard_normal(70_007), rng.integers(0, 3, 60_000).astype(float)):
        count = samples.size // block
        expected = np.median(samples[: count * block].reshape(count, block), axis=1)
        npt.assert_array_equal(_medians(samples, block), expected)


def test_outliers_that_overlap_the_noise_raise_a_warning() -> None:
    """Most outliers of 6 deviations are too small to be replaced; the finding contains the larger N."""
    rng = np.random.default_rng(3_909)
    samples = rng.standard_normal(50_000)
    samples += 6 * rng.standard_normal(samples.size) * (rng.random(samples.size) < 0.005)
    found = fit(_series(samples))
    (finding,) = [f for f in found.findings if f.code == "spikes"]
    assert finding.level == "warning"
    kept = fit(_series(samples), clean=False)
    larger = (kept["N"].value or 0) / (found["N"].value or 1) - 1
    percent = float(finding.text.partition("is about ")[2].partition(" %")[0])
    assert percent / 100 == pytest.approx(larger, rel=0.2)


@pytest.mark.parametrize(("freedom", "warned"), [(3.0, True), (8.0, False)])
def test_tails_with_infinite_kurtosis_raise_a_warning(freedom: float, *, warned: bool) -> None:
    """The kurtosis of Student's t is infinite with 3 degrees of freedom and 1.5 with 8."""
    samples = np.random.default_rng(3_910).standard_t(freedom, 50_000)
    codes = [f.code for f in fit(_series(samples)).findings if f.level == "warning"]
    assert codes == (["heavy-tails"] if warned else [])


def torn(counts: FloatArray, share: float, rng: np.random.Generator, *, side: int = 1) -> FloatArray:
    """Return counts of which a share has the high byte of the sample before (side 1) or after (-1)."""
    wrong = rng.random(counts.size) < share
    high = np.floor(np.roll(counts, side) / 256)
    return np.asarray(np.where(wrong, 256 * high + counts % 256, counts))


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("noise", [30.0, 60.0])
def test_torn_reads_are_reported_and_mostly_corrected(noise: float, side: int) -> None:
    """The side of the neighbour is found; N is right to 0.6 %."""
    rng = np.random.default_rng(67)
    counts = np.round(noise * rng.standard_normal(60_000))
    series = _series(1e-5 * torn(counts, 0.003, rng, side=side))
    corrected, (finding,) = without_torn_reads(series)
    assert (finding.code, finding.level, finding.axis) == ("torn-reads", "warning", "gyro_x")
    assert "of the reads are torn" in finding.text
    assert ("before" if side > 0 else "after") in finding.text
    changed = corrected.samples != series.samples
    npt.assert_allclose(np.abs((corrected.samples - series.samples)[changed]), 256e-5, rtol=1e-9)
    wrong = series.samples != 1e-5 * counts
    # At the limit of the odds every second correction is wrong.
    assert np.count_nonzero(changed & ~wrong) <= 0.3 * np.count_nonzero(wrong)
    cleaned, _ = clean(series)
    assert float(np.std(cleaned.samples)) == pytest.approx(1e-5 * float(np.std(counts)), rel=6e-3)


def in_kind(kind: str, n: int, rng: np.random.Generator) -> FloatArray:
    """Return noise of a kind, with a deviation of about 1."""
    normal = rng.standard_normal(n)
    match kind:
        case "Laplace":
            return rng.laplace(size=n)
        case "Student's t":
            return rng.standard_t(4, n)
        case "drift":
            return np.asarray(normal + 0.1 * rng.standard_normal(n).cumsum())
        case "smoothed":
            return np.convolve(normal, np.full(10, 0.3), "same")
        case "outliers":
            return np.asarray(normal + 6 * (rng.random(n) < 0.003) * rng.standard_normal(n))
    return normal


@pytest.mark.parametrize("kind", ["normal", "Laplace", "Student's t", "drift", "smoothed", "outliers"])
def test_noise_in_steps_has_no_torn_reads(kind: str) -> None:
    """Ten records of each kind with random noise and level."""
    for seed in range(10):
        rng = np.random.default_rng([671, seed])
        noise, level = rng.uniform(6, 150), rng.integers(-3000, 3000)
        samples = np.round(noise * in_kind(kind, 12_000, rng) + level)
        assert not without_torn_reads(_series(1e-5 * samples))[1]

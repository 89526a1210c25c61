"""Tests of spectral fits of records with gaps."""

from collections import Counter

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan.dct import dct_bins
from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.fitting.spectral.blocks import Block, _bins, _runs, bin_blocks, make_blocks, scale_of
from imucal.recording import AxisSeries
from tests.benchmarks.lost_samples import fit_with_losses
from tests.fitting.fits import fitted, simulated
from tests.raising import raises

TEXT = "N=1 + K=1e-2"
N = 30_000


def series_of(samples: FloatArray) -> AxisSeries:
    return AxisSeries.from_samples(samples, rate_hz=1.0).finite()


def with_gaps(kind: str, seed: int) -> FloatArray:
    rng = np.random.default_rng(1000 + seed)
    samples = simulated(TEXT, N, seed)
    if kind == "scattered":
        samples[1:-1][rng.random(N - 2) < 0.1] = np.nan
    else:
        for start in rng.integers(100, N - 1000, 6):
            samples[start : start + 700] = np.nan
    return samples


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["scattered", "bursts"])
def test_intervals_cover_the_truth_with_missing_samples(kind: str) -> None:
    """N and K are unbiased, and their intervals have the nominal coverage in 20 records."""
    hits = np.zeros(2)
    errors = []
    for seed in range(20):
        result = fitted(series_of(with_gaps(kind, seed)), "N + K")
        hits += [result[k].low <= truth <= result[k].high for k, truth in (("N", 1.0), ("K", 1e-2))]
        errors.append([(result["N"].value or 0) - 1, 100 * (result["K"].value or 0) - 1])
    # Three standard errors of a proportion of 0.95 in 20 records.
    assert np.all(hits / 20 >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / 20))
    # The standard errors of K and N are about 8 % and 0.7 %; the limit is four of them over sqrt(20).
    assert np.all(np.abs(np.mean(errors, axis=0)) < [0.006, 0.07])


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.3, 0.5])
def test_intervals_of_a_given_model_cover_the_truth_with_many_lost_samples(share: float) -> None:
    """The coverage in 20 records is at most three standard errors below 95 %, and no filter is found."""
    hits: Counter[str] = Counter()
    for seed in range(20):
        fit = fit_with_losses("N=0.1 + B=0.3 + K=0.05", share, (811, seed))
        for key, truth in (("N", 0.1), ("B", 0.3), ("K", 0.05)):
            hits[key] += fit[key].low <= truth <= fit[key].high
        assert all(finding.code != "output-filter" for finding in fit.findings)
    assert min(hits.values()) >= 20 * (0.95 - 3 * np.sqrt(0.95 * 0.05 / 20))


@pytest.mark.parametrize(("share", "burst"), [(0.3, 3), (0.5, 1)])
def test_many_lost_samples_neither_bias_n_nor_look_like_a_filter(share: float, burst: int) -> None:
    """Radio logs lose that many samples, singly or in short bursts."""
    n, errors, squares = 20_000, [], []
    for seed in range(4):
        samples = simulated("N=1 + B=0.3", n, 60 + seed)
        lost = np.repeat(np.random.default_rng(seed).random(n // burst + 1) < share, burst)[:n]
        samples[1:-1][lost[1:-1]] = np.nan
        result = fitted(series_of(samples))
        assert all(finding.code != "output-filter" for finding in result.findings)
        assert result["N"].value is not None
        errors.append(result["N"].value - 1)
        squares.append(result.goodness.chi2_per_bin)
    # The standard error of a mean of four is 0.5 %.
    assert abs(np.mean(errors)) < 0.02
    assert np.mean(squares) < 1.15


def test_long_gaps_separate_blocks_and_short_gaps_are_completed() -> None:
    """One gap of 500 samples makes two blocks; ten single missing samples make none."""
    samples = simulated(TEXT, N, 1)
    samples[10_000:10_500] = np.nan
    samples[20_000:20_100:10] = np.nan
    found = make_blocks(series_of(samples))
    assert [block.bins.n for block in found.blocks] == [10_000, N - 10_500]
    assert found.findings[0].text == (
        "The fit allows for gaps: the likelihoods of 2 blocks between long gaps are multiplied; "
        "10 missing samples in short gaps are replaced by their expected values."
    )


@pytest.mark.parametrize("count", [1, 64, 1000])
def test_the_lowest_bins_contain_only_their_own_ordinates(count: int) -> None:
    """The part has at least the requested number of ordinates, in complete bins, with all their data."""
    samples = simulated(TEXT, N, 4)
    samples[::100] = np.nan
    (block,) = make_blocks(series_of(samples)).blocks
    part = block.lowest(count)
    size = int(part.bins.count.sum())
    assert size >= count > size - part.bins.count[-1]
    npt.assert_array_equal(part.ordinates, block.ordinates[:size])
    for name in ("variance", "kept"):
        expected_part, found = getattr(block, name), getattr(part, name)
        assert (found is None) == (expected_part is None)
        if expected_part is not None:
            npt.assert_array_equal(found, expected_part[:size])
    assert part.bins.n == block.bins.n


def test_the_lowest_ordinates_end_at_the_end_of_a_bin() -> None:
    """Any requested number is rounded up to complete bins, also where bins are wide."""
    bins = dct_bins(3000)
    block = Block(offset=0, bins=bins, ordinates=np.arange(2999.0))
    ends = bins.first + bins.count - 1
    for count in range(1, 2999, 7):
        assert block.lowest(count).ordinates.size == ends[ends >= count][0]


def test_short_runs_are_omitted_and_counted() -> None:
    """Thirty samples between two long gaps are not used."""
    samples = simulated(TEXT, 5000, 2)
    samples[1000:1500] = np.nan
    samples[1530:2000] = np.nan
    found = make_blocks(series_of(samples))
    assert len(found.blocks) == 2
    assert "30 samples in runs shorter than 64 are left out" in found.findings[0].text


def test_a_record_of_fragments_is_rejected() -> None:
    """If no run is long enough, the error states the required length."""
    samples = np.full(20_000, np.nan)
    for start in range(0, 20_000, 1000):
        samples[start : start + 30] = np.random.default_rng(start).standard_normal(30)
    with pytest.raises(DataError) as caught:
        make_blocks(series_of(samples))
    assert str(caught.value) == (
        "gyro_x: no run of 64 samples without a long gap in 600 samples; expected a recording with few gaps"
    )


def test_more_long_gaps_than_blocks_are_supported() -> None:
    """The number of blocks is limited, so the shorter gaps are completed."""
    samples = simulated(TEXT, 60_000, 3)
    for start in range(500, 59_000, 1000):
        samples[start : start + 80] = np.nan
    result = fitted(series_of(samples), "N + K")
    assert result["N"].value == pytest.approx(1.0, abs=0.03)


def test_a_record_without_gaps_has_no_finding() -> None:
    """The record is one block at offset 0."""
    found = make_blocks(series_of(simulated(TEXT, 1000, 5)))
    assert found.findings == ()
    assert [block.offset for block in found.blocks] == [0]


@pytest.mark.parametrize(("length", "offsets"), [(64, [0]), (65, [0, 565])])
def test_a_gap_of_more_than_64_samples_separates_blocks(length: int, offsets: list[int]) -> None:
    """Shorter gaps are completed; a block's offset includes the missing samples before it."""
    samples = simulated(TEXT, 2000, 6)
    samples[500 : 500 + length] = np.nan
    assert [block.offset for block in make_blocks(series_of(samples)).blocks] == offsets


def test_the_finding_of_one_missing_sample_is_singular() -> None:
    """A run of exactly 64 samples, the shortest allowed, is used."""
    samples = simulated(TEXT, 1064, 7)
    samples[10] = np.nan
    samples[500:1000] = np.nan
    found = make_blocks(series_of(samples))
    assert [block.bins.n for block in found.blocks] == [500, 64]
    assert found.findings[0].text == (
        "The fit allows for gaps: the likelihoods of 2 blocks between long gaps are multiplied; "
        "one missing sample in short gaps is replaced by its expected value."
    )
    assert (found.findings[0].level, found.findings[0].axis) == ("info", "gyro_x")


@pytest.mark.parametrize(("blocks", "same"), [(4, True), (5, False), (48, False)])
def test_many_blocks_have_wider_bins(blocks: int, *, same: bool) -> None:
    """Up to four blocks have the usual bins; more blocks share 512 single bins and 192 per octave."""
    found, expected_part = _bins(20_000, blocks), dct_bins(20_000)
    assert (found.size == expected_part.size) == same
    if not same:
        expected = dct_bins(20_000, singles=max(16, 512 // blocks), per_octave=max(10, 192 // blocks))
        npt.assert_array_equal(found.first, expected.first)


def test_at_most_48_blocks_are_separated_by_the_longest_gaps() -> None:
    """Of 60 gaps longer than 64 samples, the 47 longest separate blocks."""
    lengths = np.random.default_rng(8).permutation(np.arange(65, 125))
    places = np.arange(200, 200 * 61, 200)
    samples = simulated(TEXT, 200 * 62, 8)
    for place, length in zip(places.tolist(), lengths.tolist(), strict=True):
        samples[place : place + length] = np.nan
    runs, lost = _runs(series_of(samples))
    longest = lengths > 125 - 48
    npt.assert_array_equal([run.first for run in runs[1:]], places[longest] + lengths[longest])
    assert (len(runs), lost) == (48, 0)


@pytest.mark.parametrize(
    ("samples", "text"),
    [
        (np.arange(63.0), "gyro_x: 63 samples, expected at least 64 for a noise model; record for longer"),
        (
            np.ones(64),
            (
                "gyro_x: all 64 samples are equal, expected noise; "
                "check that the sensor was on and that its resolution shows its noise"
            ),
        ),
        (
            3 * np.arange(64.0),
            (
                "gyro_x: all 64 samples are on one straight line, expected noise; "
                "check that the column holds a measurement and not a counter"
            ),
        ),
    ],
)
def test_samples_without_noise_are_rejected(samples: FloatArray, text: str) -> None:
    """The error distinguishes few samples, equal samples and a ramp."""
    with pytest.raises(DataError) as caught:
        scale_of(series_of(samples))
    assert str(caught.value) == text


@pytest.mark.parametrize(("size", "scale"), [(1.0, 1.0), (1.4, 1.0), (1.5, 2.0), (3e-5, 2.0**-15)])
def test_the_scale_is_the_power_of_two_nearest_to_the_steps(size: float, scale: float) -> None:
    """The samples alternate by steps of the given size."""
    assert scale_of(series_of(size * (np.arange(100.0) % 2))) == scale


def test_a_bend_of_1e_8_is_noise_and_of_1e_10_is_rounding() -> None:
    """A ramp with steps of 1 has one sample off the line."""
    ramp = np.arange(100.0)
    assert scale_of(series_of(ramp + 1e-8 * (ramp == 50))) == 1.0
    with raises(DataError, "one straight line", place="gyro_x"):
        scale_of(series_of(ramp + 1e-10 * (ramp == 50)))


def test_of_equally_long_gaps_the_first_separate_blocks() -> None:
    """Logs with regular dropouts reach the limit: the rest of the record is one block with completed gaps."""
    samples = simulated(TEXT, 60 * 300, 8)
    for start in range(200, samples.size, 300):
        samples[start : start + 100] = np.nan
    samples[-100 - 300 :] = simulated(TEXT, 400, 9)
    samples[50 * 300 + 180 : 50 * 300 + 300] = np.nan
    runs, trials = _runs(series_of(samples))
    assert len(runs) == 48
    assert not trials
    assert sum(run.stop - run.start for run in runs) == np.isfinite(samples).sum()
    # The gap of 120 samples is the longest, so only the first 46 of the others separate blocks.
    assert [run.first for run in runs[:47]] == [300 * number for number in range(47)]
    assert runs[47].first == 51 * 300


@pytest.mark.parametrize(("share", "level"), [(0.5, "info"), (0.7, "warning")])
def test_many_completed_samples_raise_a_warning(share: float, level: str) -> None:
    """The spectrum is then a sum of power laws; samples missing in a long gap are not completed."""
    samples = simulated("N=1", 8000, 71)
    lost = np.random.default_rng(72).random(samples.size) < share
    scattered = np.where(lost, np.nan, samples)
    scattered[[0, -1]] = samples[[0, -1]]
    (finding,) = (one for one in fitted(series_of(scattered), "N").findings if one.code == "gaps-in-fit")
    assert finding.level == level
    assert bool(finding.advice) is (level == "warning")
    samples[2000:6000] = np.nan
    (finding,) = (one for one in fitted(series_of(samples), "N").findings if one.code == "gaps-in-fit")
    assert finding.level == "info"


def in_trials(seed: int, *, size: int, low: int, high: int, number: int = 300) -> FloatArray:
    """Return white noise, N = 1, in runs of `size` samples, with pauses of `low` to `high` samples."""
    rng = np.random.default_rng([20261129, seed])
    samples = np.full(number * (size + high), np.nan)
    place = 0
    for pause in rng.integers(low, high, number).tolist():
        samples[place : place + size] = rng.standard_normal(size)
        place += size + pause
    return samples[: place - pause]


@pytest.mark.parametrize(("size", "low", "high"), [(100, 300, 2650), (20, 300, 1000), (60, 100, 400)])
def test_short_runs_between_pauses_have_the_right_white_noise(size: int, low: int, high: int) -> None:
    """No sample is completed, and N is that of the standard deviations within the runs."""
    samples = in_trials(1, size=size, low=low, high=high)
    runs = samples[np.isfinite(samples)].reshape(-1, size)
    expected = np.sqrt(np.sum(runs.var(axis=1)) / (len(runs) * (size - 1) / size))
    fit = fitted(series_of(samples), "N")
    assert fit["N"].value == pytest.approx(expected, rel=5e-3)
    assert fit["N"].low <= 1 <= fit["N"].high
    (finding,) = (finding for finding in fit.findings if finding.code == "gaps-in-fit")
    assert finding.level == "info"
    assert "missing" not in finding.text


def test_blocks_of_equal_length_are_one_group_of_summed_ordinates() -> None:
    """The sums of the group are those of its blocks."""
    blocks = make_blocks(series_of(in_trials(2, size=100, low=300, high=2650)))
    assert len(blocks.blocks) == 300
    assert [len(group) for group in blocks.groups] == [300]
    separate = bin_blocks(blocks.blocks, blocks.scale)
    together = blocks.binned()
    for name in ("size", "power"):
        sums = getattr(separate, name).reshape(300, -1).sum(axis=0)
        npt.assert_allclose(getattr(together, name), sums, rtol=1e-12)


def test_runs_of_many_lengths_are_cut_to_few() -> None:
    """The cut costs less than 9 % of any run."""
    rng = np.random.default_rng(3)
    samples = np.full(300 * 3000, np.nan)
    sizes = rng.integers(60, 400, 300)
    for number, size in enumerate(sizes.tolist()):
        samples[3000 * number : 3000 * number + size] = rng.standard_normal(size)
    blocks = make_blocks(series_of(samples))
    lengths = np.array([block.bins.n for block in blocks.blocks])
    assert np.unique(lengths).size <= 24
    assert np.all((lengths <= sizes) & (lengths > 0.9 * sizes))


@pytest.mark.parametrize("burst", [1, 10])
@pytest.mark.parametrize(
    ("model", "symbol", "truth", "width"), [("N=1 + B=0.3", "B", 0.3, 1.3), ("N=1 + K=0.01", "K", 0.01, 1.1)]
)
def test_slow_noise_widens_the_intervals_of_a_sparse_record(
    model: str, symbol: str, truth: float, width: float, burst: int
) -> None:
    """Its completion takes the noise of single samples for white: N alone would be wrong by 1 to 20 %."""
    samples = simulated(model, 60_000, 105)
    lost = np.random.default_rng([92, 105]).random(samples.size // burst) < 0.92
    samples[np.repeat(lost, burst)] = np.nan
    fit = fitted(series_of(samples))
    assert fit["N"].low <= 1 <= fit["N"].high
    assert fit[symbol].low <= truth <= fit[symbol].high
    assert fit["N"].high > width * fit["N"].low
    # How the gaps were handled, and that the intervals are wider.
    assert [f.level for f in fit.findings if f.code == "gaps-in-fit"] == ["warning", "warning"]


def test_a_long_sparse_record_allows_for_a_share_of_n_and_not_for_chance() -> None:
    """The bias does not fall with the length of the record as the standard error does."""
    samples = simulated("N=1 + K=0.01", 600_000, 501)
    samples[np.random.default_rng([92, 501]).random(samples.size) < 0.92] = np.nan
    fit = fitted(series_of(samples))
    assert fit["N"].low <= 1 <= fit["N"].high
    assert 1.1 < fit["N"].high / fit["N"].low < 1.3


def test_white_noise_of_a_sparse_record_is_known_to_chance() -> None:
    samples = simulated("N=1", 60_000, 107)
    samples[np.random.default_rng([92, 107]).random(samples.size) < 0.92] = np.nan
    fit = fitted(series_of(samples))
    assert fit["N"].low <= 1 <= fit["N"].high
    assert fit["N"].high / fit["N"].low < 1.06
    assert len([f for f in fit.findings if f.code == "gaps-in-fit"]) == 1


def test_a_sparse_record_without_neighbours_is_fitted() -> None:
    """Every third sample is there."""
    samples = simulated("N=1", 30_000, 106)
    samples[np.arange(samples.size) % 3 > 0] = np.nan
    fit = fitted(series_of(samples))
    assert fit["N"].low <= 1 <= fit["N"].high


@pytest.mark.slow
@pytest.mark.parametrize(("burst", "model"), [(1, "N=1"), (10, "N=1 + B=0.3")])
def test_intervals_cover_the_truth_if_92_percent_of_the_samples_are_lost(burst: int, model: str) -> None:
    """N covers in at least 17 of 20 records, three standard errors below 95 %; B is not invented."""
    covered = invented = 0
    for seed in range(20):
        samples = simulated(model, 100_000, seed)
        lost = np.random.default_rng([92, seed]).random(samples.size // burst) < 0.92
        samples[np.repeat(lost, burst)] = np.nan
        fit = fitted(series_of(samples))
        covered += fit["N"].low <= 1 <= fit["N"].high
        invented += fit["B"].low > (0.3 if "B" in model else 0.0)
    assert covered >= 17
    assert invented <= 2

"""Faulty clocks with known truth are read correctly, or refused with both possible rates."""

import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ChoiceError
from imucal.readers import read
from imucal.readers.clocks import ClockReading, clock_from_stamps, repeats
from imucal.readers.clocks.changes import rate_change
from tests.cli.run import run
from tests.raising import raises
from tests.readers.clocks.awkward import (
    MS,
    SECOND,
    SIZES,
    START,
    US,
    Awkward,
    coarse,
    even,
    fifo,
    fifos,
    fused,
    kinds,
    lossy,
    scheduled,
    switched,
    throttled,
)
from tests.readers.logs import Samples, imu_messages, write_bag, write_mcap
from tests.readers.tables.texts import lines, xyz
from tests.readers.ulog.test_ulog import SENSOR, Writer
from tests.slow_cases import first_by_default

KINDS = dict(kinds())
SI = "gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"


def values_of(case: Awkward, quantum: float = 0.0) -> FloatArray:
    """Return white samples, shape (6, n), rounded to multiples of the quantum if there is one."""
    values = np.random.default_rng(1).normal(0, 1, (6, int(case.samples.max()) + 1))[:, case.samples]
    return np.round(values / quantum) * quantum if quantum else values


def clock_of(case: Awkward, rate_hz: float | None = None) -> ClockReading:
    twice = repeats(case.stamps, values_of(case))
    return clock_from_stamps(case.stamps, source="stamps", repeated=twice, rate_hz=rate_hz)


def is_right(case: Awkward) -> None:
    """Check the rate to 0.1 %, the kept samples, and the findings."""
    reading = clock_of(case)
    once = np.unique(case.samples).size
    assert reading.clock.rate_hz == pytest.approx(case.rate_hz, rel=1e-3)
    # A wrong stamp may also exclude one of its neighbours.
    assert once - 2 <= reading.clock.n <= once
    found = [finding.code for finding in reading.findings]
    assert not case.finding or case.finding in found


@pytest.mark.parametrize("name", [name for name, case in KINDS.items() if not case.refused])
def test_a_faulty_clock_gives_rate_samples_and_finding(name: str) -> None:
    """Faults: jitter, losses, coarse ticks, settings, stalls and repeats."""
    is_right(KINDS[name])


@pytest.mark.parametrize("size", first_by_default(sorted(SIZES, key=lambda size: size % 3), 9))
def test_batches_of_any_size_give_the_rate(size: int) -> None:
    """Stamp intervals are 1 us to 1 ms, clocks count in ns, us or ms, and sizes are fixed or random."""
    for _, case in fifos((size,)):
        is_right(case)
    for tick in (1, US, MS):
        case = fifo(100.0, size, 1000.0, tick)
        is_right(case)
        assert clock_of(case).clock.missing == 0


@pytest.mark.parametrize("name", [name for name, case in KINDS.items() if case.refused])
def test_both_explanations_are_reported_and_each_can_be_read(name: str, tmp_path: Path) -> None:
    """If most samples, or every nth one, would be missing, the user must choose. Each reported rate works."""
    case = KINDS[name]
    path = tmp_path / "log.csv"
    path.write_text(lines(f"t_ns,{SI}", case.stamps.tolist(), *values_of(case).tolist()), encoding="utf-8")
    with pytest.raises(ChoiceError) as caught:
        read(path)
    pattern = (
        r"the time stamps fit two rates: ([\d.]+) Hz with (\d+)% of the samples missing, or ([\d.]+) Hz "
        r"(?:in batches of about \d+|on a clock with ticks of 5 ms); expected one; give the sampling rate$"
    )
    found = re.search(pattern, str(caught.value))
    assert found is not None
    assert str(caught.value).startswith(f"{path}: ")
    rates = float(found[1]), float(found[3])
    assert [fix.value for fix in caught.value.fixes] == [found[1], found[3]]
    assert {fix.argument for fix in caught.value.fixes} == {"rate_hz"}
    assert min(abs(rate / case.rate_hz - 1) for rate in rates) < 1e-3
    most, none = (read(path, rate_hz=rate).series[0].clock for rate in rates)
    assert (most.rate_hz, none.rate_hz) == rates
    share = most.missing / most.grid_size
    assert share == pytest.approx(int(found[2]) / 100, abs=0.02)
    assert (most.n, none.n) == (case.samples.size, case.samples.size)


def test_the_rate_option_in_a_refusal_works(tmp_path: Path) -> None:
    case = lossy(100.0, 0.7, n=3000)
    path = tmp_path / "log.csv"
    values = 1e-3 * values_of(case)
    path.write_text(lines(f"t_ns,{SI}", case.stamps.tolist(), *values.tolist()), encoding="utf-8")
    refused = run("adev", path.name, cwd=tmp_path)
    assert (refused.returncode, refused.stdout) == (3, "")
    assert "Use --rate 100 or --rate " in refused.stderr
    typed = run("adev", path.name, "--rate", "100", cwd=tmp_path)
    assert typed.returncode == 0
    # tau0 is the first averaging time.
    assert ",0.01," in typed.stdout.splitlines()[1]


@pytest.mark.parametrize("rate", [0.5, 25_000.0])
def test_an_implausible_rate_must_be_given(rate: float, tmp_path: Path) -> None:
    """Fibre-optic and seismic sensors have more than 20 kHz; their rate can be given."""
    case = even(rate, n=300)
    path = tmp_path / "log.csv"
    path.write_text(lines(f"t_ns,{SI}", case.stamps.tolist(), *values_of(case).tolist()), encoding="utf-8")
    text = (
        f"column t_ns gives {rate:g} Hz; expected the rate of an IMU, 1 Hz to 20000 Hz; give the sampling "
        "rate"
    )
    with raises(ChoiceError, f"{re.escape(text)}$", argument="rate_hz"):
        read(path)
    assert read(path, rate_hz=rate).series[0].rate_hz == rate


def test_pauses_of_a_log_are_not_ambiguous() -> None:
    """Hundreds of consecutive samples identify the rate, however long the pauses are."""
    case = throttled(200.0, 1200, 40_000, 200_000)
    assert clock_of(case).clock.rate_hz == pytest.approx(200)
    assert clock_of(case).clock.missing == 4 * 38_800


@pytest.mark.parametrize(
    "name", ["300 trials of 100", "64 of 72", "half of the time", "903 Hz in 1 ms, lost 0.03"]
)
def test_missing_samples_are_counted(name: str) -> None:
    """Causes: pauses between trials, overruns of a buffer, and losses on a coarse clock."""
    case = KINDS[name]
    clock = clock_of(case).clock
    lost = int(case.samples[-1] - case.samples[0]) + 1 - case.samples.size
    assert clock.missing == pytest.approx(lost, rel=1e-3, abs=5)


def test_steps_of_ten_milliseconds_are_no_batches() -> None:
    """A bus delivers the samples of a buffer faster, so the pauses separate trials. A given rate decides."""
    case = throttled(100.0, 200, 1000, 40_000)
    assert clock_of(case).clock.rate_hz == pytest.approx(100, rel=1e-6)
    assert clock_of(case).clock.missing == pytest.approx(31_200, abs=1)
    assert clock_of(case, 20.0).clock.missing == 0


@pytest.mark.parametrize(
    ("case", "rates"),
    [
        (throttled(200.0, 9, 10), (200.0, 180.0)),
        (throttled(100.0, 9, 10), (100.0, 90.0)),
        (coarse(200.0, 4.0 * MS), (250.0, 200.0)),
    ],
)
def test_a_cycle_of_losses_or_of_ticks_is_asked(case: Awkward, rates: tuple[float, float]) -> None:
    """Every nth sample is lost, or the ticks of a clock are shorter than the period. Each rate is read."""
    with raises(ChoiceError, "the time stamps fit two rates", argument="rate_hz") as caught:
        clock_of(case)
    npt.assert_allclose([float(fix.value) for fix in caught.value.fixes], rates, rtol=1e-4)
    for rate, fix in zip(rates, caught.value.fixes, strict=True):
        reading = clock_of(case, float(fix.value))
        assert not {"two-readings", "rate-given"} & {finding.code for finding in reading.findings}
        assert reading.clock.n == case.samples.size
        share = reading.clock.missing / reading.clock.grid_size
        assert share == pytest.approx(1 - min(rates) / rate if rate == max(rates) else 0, abs=1e-3)


def test_both_rates_of_short_regular_trials_or_a_buffer_are_reported() -> None:
    """100 samples in 0.1 s every 0.4 s may be those of a buffer. The other rate reads the log too."""
    case = throttled(1000.0, 100, 400, 40_000)
    (note,) = (finding for finding in clock_of(case).findings if finding.code == "two-readings")
    assert note.level == "warning"
    assert "250 Hz, which is used, or 1000 Hz with 0.75 of" in note.text
    reading = clock_of(case, 1000.0)
    assert not {"two-readings", "rate-given"} & {finding.code for finding in reading.findings}
    assert reading.clock.missing == pytest.approx(0.75 * 40_000, abs=300)


def test_long_batches_of_fast_steps_are_asked() -> None:
    """No usual buffer has 500 samples, but a trial does."""
    case = throttled(1000.0, 500, 4000, 80_000)
    with raises(ChoiceError, "1000 Hz with 88% of the samples missing", argument="rate_hz"):
        clock_of(case)
    assert clock_of(case, 1000.0).clock.missing == pytest.approx(19 * 3500, abs=20)


@pytest.mark.parametrize("jitter", [0.01, 0.02, 0.05])
@pytest.mark.parametrize("share", [0.01, 0.05, 0.2, 0.3])
@pytest.mark.parametrize("rate", [500.0, 499.9])
def test_losses_are_counted_if_a_tick_is_half_a_period(rate: float, share: float, jitter: float) -> None:
    """Jitter moves a stamp to the millisecond before."""
    case = lossy(rate, share, jitter=jitter, n=20_000, seed=40_713)
    case = replace(case, stamps=case.stamps // MS * MS)
    reading = clock_of(case)
    assert reading.clock.rate_hz == pytest.approx(rate, rel=1e-3)
    assert reading.clock.missing == pytest.approx(20_000 - case.samples.size, rel=0.02, abs=5)
    assert "uneven-stamps" not in {finding.code for finding in reading.findings}


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("rate", [952.3, 990.2, 1003.9])
def test_a_tick_slightly_shorter_than_the_period_is_no_period(rate: float, share: float) -> None:
    """A clock with 1024 ticks a second stamps samples of which some are lost."""
    case = coarse(rate, SECOND / 1024, n=20_000, lost=share, seed=61_907)
    reading = clock_of(case)
    assert reading.clock.rate_hz == pytest.approx(rate, rel=2e-4)
    assert reading.clock.missing == pytest.approx(
        np.ptp(case.samples) + 1 - case.samples.size, rel=0.01, abs=5
    )


def test_a_given_rate_counts_losses_that_the_stamps_hide() -> None:
    """With ticks of two periods, the stamps show a mean rate that is low, with a warning."""
    case = coarse(415.2, 5.0 * MS, n=20_000, lost=0.1, seed=50_311)
    reading = clock_of(case)
    assert reading.clock.rate_hz == pytest.approx(0.9 * 415.2, rel=0.02)
    assert "uneven-stamps" in {finding.code for finding in reading.findings}
    given = clock_of(case, 415.2)
    assert given.clock.rate_hz == 415.2
    wrong = clock_of(case, 250.0)
    assert "rate-given" in {finding.code for finding in wrong.findings}


def test_hidden_losses_are_reported() -> None:
    """The fit of stamps with a jitter of 0.3 periods can't find single losses, but the stamps wander."""
    case = lossy(100.0, 0.05, jitter=0.3, n=20_000, seed=50_329)
    kept = np.delete(np.arange(case.stamps.size), np.s_[5000:5400])
    reading = clock_of(replace(case, stamps=case.stamps[kept], samples=case.samples[kept]))
    is_right = reading.clock.rate_hz == pytest.approx(100, rel=5e-3)
    assert is_right or "uneven-stamps" in {finding.code for finding in reading.findings}


@pytest.mark.parametrize("pauses", [0, 3])
@pytest.mark.parametrize(
    ("case", "before", "after", "edge"),
    [
        (switched(100.0, 50.0, share=0.3), 100.0, 50.0, 1800),
        (switched(104.0, 208.0, share=0.8), 104.0, 208.0, 4800),
        (switched(100.0, 25.0, n=100_000, share=0.6), 100.0, 25.0, 60_000),
        (fused(9.5, share=0.3), 19.0, 9.5, 3600),
        (fused(100.0, share=0.8, offset=0.1), 200.0, 100.0, 9600),
    ],
)
def test_the_rate_of_a_part_is_asked_if_a_log_has_two_rates(
    case: Awkward, before: float, after: float, edge: int, pauses: int
) -> None:
    """The given rate chooses the part. Pauses do not change the choice."""
    n = case.stamps.size
    stops = np.searchsorted(np.linspace(0, n, pauses + 2)[1:-1], np.arange(n)) * 100 * SECOND
    case = replace(case, stamps=case.stamps + stops)
    with raises(ChoiceError, "the sampling rate changes from", argument="rate_hz") as caught:
        clock_of(case)
    named = [float(fix.value) for fix in caught.value.fixes]
    npt.assert_allclose(named, [before, after], rtol=2e-3)
    for given in named:
        reading = clock_of(case, given)
        (note,) = (finding for finding in reading.findings if finding.code == "rate-changes")
        assert note.level == "warning"
        rates = [float(rate) for rate in re.findall(r"([0-9.]+) Hz", note.text)]
        npt.assert_allclose(rates, [before, after, given], rtol=2e-3)
        assert reading.clock.rate_hz == given
        assert "rate-given" not in {finding.code for finding in reading.findings}
        kept = reading.order
        assert kept is not None
        is_first = given == named[0]
        assert (kept.max() < edge) == is_first
        assert kept.size == pytest.approx(edge if is_first else n - edge, abs=0.02 * n)


def test_the_rate_of_one_sensor_does_not_change() -> None:
    """Losses that start late, gaps, batches and coarse clocks are not changes of the rate."""
    rng = np.random.default_rng(12)
    case = even(100.0, n=8000)
    for share in (0.1, 0.4, 0.6):
        lost = (rng.random(8000) < share) & (case.samples > 3000)
        assert rate_change(case.stamps[~lost]) is None
    for name, clock in (*KINDS.items(), *fifos()):
        assert rate_change(clock.stamps) is None, name


def test_a_given_rate_reads_one_part_of_three_rates() -> None:
    """Each change is reported."""
    steps = np.repeat([SECOND // 100, SECOND // 50, SECOND // 200], [2000, 5000, 2000])
    reading = clock_from_stamps(START + np.cumsum(steps), source="stamps", rate_hz=50.0)
    assert [f.code for f in reading.findings if f.level == "warning"] == ["rate-changes"] * 2
    assert reading.clock.n == pytest.approx(5000, abs=100)
    assert reading.clock.missing == 0


@pytest.mark.parametrize("jitter", [0.001, 0.05])
@pytest.mark.parametrize(("keep", "of"), [(2, 3), (7, 8), (32, 33), (12, 16), (100, 110)])
@pytest.mark.parametrize("rate", [208.0, 500.0, 1000.0])
def test_a_duty_cycle_with_jitter_keeps_the_rate_of_the_sensor(
    rate: float, keep: int, of: int, jitter: float
) -> None:
    """If a clock with coarse ticks fits equally well, the user is asked for the rate."""
    case = even(rate, MS, n=40_000, jitter=jitter)
    stamps = case.stamps[case.samples % of < keep]
    lost = 40_000 - stamps.size
    try:
        reading = clock_from_stamps(stamps, source="stamps")
    except ChoiceError as error:
        named = [float(fix.value) for fix in error.fixes]
        assert min(abs(hz / rate - 1) for hz in named) < 1e-3
        reading = clock_from_stamps(stamps, source="stamps", rate_hz=rate)
        assert "rate-given" not in {finding.code for finding in reading.findings}
    assert reading.clock.rate_hz == pytest.approx(rate, rel=1e-3)
    assert "two-readings" not in {finding.code for finding in reading.findings}
    # The ticks of 1000 Hz in ms, with jitter, move samples into the gaps.
    assert rate == 1000 or reading.clock.missing == pytest.approx(lost, abs=10)


def test_buffers_and_stalls_are_not_duty_cycles() -> None:
    """A gap shifts the phase of a buffer; after a stall the stamps catch up."""
    case = fifo(208.0, 2, 100.0, MS, n=2500, anchor="last")
    keep = (case.samples < 833) | (case.samples >= 1833)
    assert clock_from_stamps(case.stamps[keep], source="stamps").clock.rate_hz == pytest.approx(208, rel=1e-3)
    stamps = even(200.0, n=8000).stamps
    stamps[::40] += 4 * MS
    reading = clock_from_stamps(stamps, source="stamps")
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-4)
    assert reading.clock.missing == 0


def test_lost_random_batches_are_gaps() -> None:
    """The rate is that of the samples within each run."""
    case = fifo(200.0, 20, 100.0, 1, seed=5, n=8000)
    keep = (case.samples < 3000) | (case.samples > 4500)
    reading = clock_of(replace(case, stamps=case.stamps[keep], samples=case.samples[keep]))
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-4)
    # The position of the gap within a batch is unknown.
    assert len(reading.clock.gaps) <= 2
    assert reading.clock.missing == pytest.approx(1501, abs=31)


def test_batches_are_distinguished_from_jitter() -> None:
    """A reader with random timing causes bursts; jitter of the stamps does not."""
    assert "bursts" in {finding.code for finding in clock_of(scheduled(200.0)).findings}
    for jitter in (0.2, 0.3, 0.5):
        assert "bursts" not in {f.code for f in clock_of(even(200.0, jitter=jitter)).findings}


@pytest.mark.parametrize("tick", [SECOND, 10 * MS])
def test_equal_values_under_equal_stamps_are_kept(tick: int, tmp_path: Path) -> None:
    """The samples are coarse: the sensor's resolution is 1.8 standard deviations."""
    case = even(104.0, tick, n=5000)
    text = [f"{stamp / SECOND:.2f}" for stamp in case.stamps.tolist()]
    path = tmp_path / "log.csv"
    samples = values_of(case, 1.8)[:3]
    path.write_text(lines(f"time (s),{SI[:32]}", text, *samples.tolist()), encoding="utf-8")
    recording = read(path)
    assert recording.series[0].n == 5000
    assert recording.series[0].rate_hz == pytest.approx(104, rel=1e-3)
    assert not {"duplicate-stamps", "held-samples"} & {finding.code for finding in recording.findings}


def test_jitter_above_a_period_is_reported_with_its_effect() -> None:
    """The finding describes the effect on the rate, and through it on N."""
    (note,) = (f for f in clock_of(even(200.0, jitter=1.5)).findings if f.code == "uneven-stamps")
    assert note.level == "warning"
    assert note.text.startswith(
        "The time stamps differ from an even grid by 1.51 sampling periods (standard deviation)"
    )
    assert "The rate, 200.001 Hz, is the mean, with a relative error of about 0.0005" in note.text
    (note,) = (f for f in clock_of(KINDS["interpolated"]).findings if f.code == "uneven-stamps")
    assert note.text.startswith("Most steps are 5 ms, as at 200 Hz, but there are 219.3 samples per second")
    assert note.text.endswith("The mean rate is used; with the rate of the steps, N would change by +4.7%.")


@pytest.mark.parametrize("jitter", [0.125, 0.15, 0.2])
@pytest.mark.parametrize("share", [0.01, 0.05, 0.2, 0.4])
@pytest.mark.parametrize("rate", first_by_default([416.0, 100.0], 1))
def test_losses_are_found_in_spite_of_jitter(rate: float, share: float, jitter: float) -> None:
    """Steps of one and of two periods overlap, but the phases of the stamps give the period."""
    case = lossy(rate, share, jitter=jitter, n=4000, seed=8123)
    reading = clock_of(case)
    clock = reading.clock
    assert clock.rate_hz == pytest.approx(rate, rel=1e-4)
    (text,) = (finding.text for finding in reading.findings if finding.code == "uneven-stamps")
    assert text.startswith("The time stamps jitter by 0.")
    lost = 4000 - case.stamps.size
    assert abs(clock.missing - lost) <= 4 + 0.04 * lost
    assert clock.n >= 0.99 * case.stamps.size


def test_short_steps_within_batches_are_not_interpolated_samples() -> None:
    """Batches have two to four samples, and their interval is close to the sensor's period."""
    for size in (2, 3, 4):
        found = {finding.code for finding in clock_of(fifo(833.0, size, 1000.0, US)).findings}
        assert "uneven-stamps" not in found


def _csv(path: Path, stamps: IntArray, values: FloatArray) -> Path:
    path = path.with_suffix(".csv")
    path.write_text(lines(f"t_ns,{SI}", stamps.tolist(), *xyz(values[:3].T), *xyz(values[3:].T)))
    return path


def _truth(stamps: IntArray, values: FloatArray) -> Samples:
    return Samples(stamps=stamps, log=stamps + 300_000, gyro=values[:3].T, accel=values[3:].T)


def _mcap(path: Path, stamps: IntArray, values: FloatArray) -> Path:
    return write_mcap(path.with_suffix(".mcap"), imu_messages(_truth(stamps, values)))


def _bag(path: Path, stamps: IntArray, values: FloatArray) -> Path:
    return write_bag(path.with_suffix(".bag"), imu_messages(_truth(stamps, values), ros1=True))


def _ulog(path: Path, stamps: IntArray, values: FloatArray) -> Path:
    log = Writer()
    log.format("sensor_gyro", SENSOR)
    log.add("sensor_gyro")
    for stamp, sample in zip(((stamps - START) // US + 1_000_000).tolist(), values[:3].T, strict=True):
        log.message("sensor_gyro", struct.pack("<QQI4f", stamp + 60, stamp, 7, *sample, 20.0))
    return log.store(path.with_suffix(".ulg"))


@pytest.mark.parametrize("write", [_csv, _mcap, _bag, _ulog])
@pytest.mark.parametrize(("size", "own_us", "seed"), [(25, 1000.0, 0), (64, 10.0, 3), (3, 100.0, 4)])
def test_batches_give_the_true_rate_and_n_in_every_format(
    write: Callable[[Path, IntArray, FloatArray], Path], size: int, own_us: float, seed: int, tmp_path: Path
) -> None:
    """25 samples with steps of 1 ms, read every 250 ms, must not be 1000 Hz with 90 % missing."""
    case = fifo(100.0, size, own_us, US, seed=seed, n=1500)
    values = values_of(case)
    recording = read(write(tmp_path / "log", case.stamps, values))
    series = recording.axis("gyroscope", "z")
    assert series.rate_hz == pytest.approx(100, rel=1e-3)
    assert (series.n, series.clock.missing) == (1500, 0)
    assert "bursts" in {finding.code for finding in recording.findings}
    # For white samples, N is the standard deviation divided by the root of the rate.
    n = float(np.std(series.samples)) / np.sqrt(series.rate_hz)
    npt.assert_allclose(n, np.std(values[2]) / np.sqrt(100.0), rtol=0.01)


@pytest.mark.parametrize("share", [0.75, 0.85, 0.95])
def test_losses_without_steps_of_one_sample_cause_a_warning(share: float) -> None:
    """At 1000 Hz in whole ms, consecutive samples are rare, so no rate explains the stamps."""
    rng = np.random.default_rng(round(1000 * share))
    kept = np.sort(rng.choice(40_000, round(40_000 * (1 - share)), replace=False))
    found = clock_from_stamps(kept.astype(np.int64) * MS, source="stamps")
    assert "uneven-stamps" in {finding.code for finding in found.findings}

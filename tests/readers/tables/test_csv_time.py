"""Time columns of a table: units, joined columns, counters, wraps, and errors for ambiguous times."""

from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.readers.tables.dates import parse_texts
from imucal.readers.tables.stamps import infer_time_unit, to_ns, unwrapped
from imucal.recording import Recording, Sensor
from tests.raising import raises
from tests.readers.tables.texts import EPOCH, N, lines, rostopic, truth, xyz

AXES = "gx (rad/s),gy (rad/s),gz (rad/s)"


def written(folder: Path, header: str, *columns: object, preamble: str = "") -> Path:
    path = folder / "log.csv"
    content = preamble + lines(f"{header},{AXES}", *columns, *xyz(truth().gyro))  # type: ignore[arg-type]
    path.write_text(content, encoding="utf-8")
    return path


def recorded(folder: Path, header: str, *columns: object, preamble: str = "", **options: object) -> Recording:
    return read(written(folder, header, *columns, preamble=preamble), ReadOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("step", "start", "unit"),
    [
        (0.01, 0.0, "s"),
        (0.01, 1.7e9, "s"),
        (5, 0, "ms"),
        (5, 1_700_000_000_000, "ms"),
        (5_000, 0, "us"),
        (10_000, 1_700_000_000_000_000, "us"),
        (10_000_000, 0, "ns"),
        (10_000_000, EPOCH, "ns"),
        (100, 1_700_000_000_000_000, "us"),
        (100, 0, None),
        (1000, 0, None),
        (1, 0, None),
        (100.0, 1.7e9, None),
        (0, 5, None),
    ],
)
def test_the_unit_of_a_time_gives_the_rate_of_an_imu(step: float, start: float, unit: str | None) -> None:
    """If several units fit, the size of a time since 1970 decides; otherwise no unit is chosen."""
    values = np.array([start + i * step for i in range(1000)])
    assert infer_time_unit(values)[0] == unit


def test_an_ambiguous_unit_is_refused(tmp_path: Path) -> None:
    """A step of 100 can be 10 Hz in ms or 10 kHz in us."""
    path = written(tmp_path, "time", [100 * i for i in range(N)])
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions())
    assert str(caught.value) == (
        f"{path}: column 'time', the time of the gyroscope, has no unit and increases by 100 per row, which "
        "is 10000 Hz in us or 10 Hz in ms; give the time unit, name it in the header, such as time_us, or "
        "give the sampling rate"
    )
    assert recorded(tmp_path, "time_ms", [100 * i for i in range(N)]).series[0].rate_hz == pytest.approx(10)
    assert recorded(tmp_path, "time (us)", [100 * i for i in range(N)]).series[0].rate_hz == pytest.approx(
        1e4
    )


def test_a_counter_needs_a_rate(tmp_path: Path) -> None:
    """A counter contains no time, but together with a rate it shows missing samples."""
    counts = [*range(200), *range(205, N + 5)]
    path = written(tmp_path, "sample", counts)
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions())
    assert str(caught.value) == (
        f"{path}: only a counter (sample) and no sampling rate for the gyroscope; expected time stamps or "
        "a rate; give the sampling rate"
    )
    clock = read(path, ReadOptions(rate_hz=50.0)).series[0].clock
    assert (clock.rate_hz, clock.missing, clock.start_ns) == (50.0, 5, None)
    assert clock.source == "counter sample at the given rate"


@pytest.mark.parametrize(
    "preamble",
    [
        "Fs,100\n",
        "// Update Rate: 100.0Hz\n",
        "# Sample rate: 0.1 kHz\n",
        "Sampling Frequency = 100 Hz\n",
        "sample_rate: 100\n",
        '"Fs (Hz)";100\n',
    ],
)
def test_the_rate_in_the_preamble_is_used(preamble: str, tmp_path: Path) -> None:
    """The decision reports the log as its source."""
    recording = recorded(tmp_path, "sample", list(range(N)), preamble=preamble)
    assert recording.series[0].rate_hz == 100.0
    assert dict(recording.source.decisions)["time"] == "100 Hz, the rate in the log"


def test_stamps_override_the_rate_in_the_preamble(tmp_path: Path) -> None:
    """A warning reports the contradiction."""
    recording = recorded(tmp_path, "time (s)", [f"{i * 0.01:.3f}" for i in range(N)], preamble="Fs,128\n")
    assert recording.series[0].rate_hz == pytest.approx(100)
    (finding,) = recording.findings
    assert finding.code == "rate-differs"
    assert finding.text == "The log declares 128 Hz, its time stamps give 100 Hz; the time stamps are used."


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_wrapped_counters_are_unwrapped(bits: int) -> None:
    true = np.arange(1000, dtype=np.int64) * 3 + (1 << bits) - 300
    counts, wraps = unwrapped(true % (1 << bits))
    npt.assert_array_equal(np.diff(counts), np.diff(true))
    assert wraps == (int(true[-1]) >> bits) - (int(true[0]) >> bits)


def test_a_restart_is_not_a_wrap() -> None:
    """The logger starts again from the middle of the counter's range."""
    counts = np.concatenate([np.arange(1000), np.arange(1000)]) + 20_000
    result, wraps = unwrapped(counts)
    npt.assert_array_equal(result, counts)
    assert wraps == 0


def test_a_wrapped_time_column_is_unwrapped(tmp_path: Path) -> None:
    """Microseconds of 32 bits wrap after 71 minutes."""
    micros = [(2**32 - 1_000_000 + i * 10_000) % 2**32 for i in range(N)]
    recording = recorded(tmp_path, "time_us", micros)
    assert recording.series[0].clock.missing == 0
    assert recording.series[0].rate_hz == pytest.approx(100)
    assert [f.text for f in recording.findings] == [
        "Column time_us started again 1 times at the end of its range; it was unwrapped."
    ]


@pytest.mark.parametrize(
    ("cell", "ns"),
    [
        ("1970-01-01T00:00:01Z", 10**9),
        ("1970-01-02 00:00:00.000000001", 86_400 * 10**9 + 1),
        ("1970-01-01T01:00:00.5+0100", 500_000_000),
        ("1970-01-01T01:00:00.5+01:00", 500_000_000),
        ("1970/1/1 00:00:00,25", 250_000_000),
        ("1970-01-01 00-00-01_500", 1_500_000_000),
        ("23:59:59.999", 86_399_999_000_000),
        ("2024-02-29T12:00:00.123456789Z", 1_709_208_000_123_456_789),
        ("2023-02-30 00:00:00", np.iinfo(np.int64).min),
        ("yesterday", np.iinfo(np.int64).min),
    ],
)
def test_dates_and_times_of_day_are_parsed_to_the_nanosecond(cell: str, ns: int) -> None:
    """Other texts are invalid."""
    assert parse_texts([cell]).tolist() == [ns]


def test_times_are_converted_to_ns_exactly() -> None:
    """Seconds as doubles become the nearest ns; integers stay exact above 2**53."""
    values = np.array([0.1, 1.25, 1_700_000_000.5, -0.25])
    assert to_ns(values, 10**9).tolist() == [
        100_000_000,
        1_250_000_000,
        1_700_000_000_500_000_000,
        -250_000_000,
    ]
    assert to_ns(np.array([2**62 - 1, 5], dtype=np.int64), 1).tolist() == [2**62 - 1, 5]


#: Times at 100 Hz in ms; the first is 1 s before the end of a minute.
TIMES = [59_000 + 10 * i for i in range(N)]
WHOLE, MILLI = [EPOCH // 10**9 + t // 1000 for t in TIMES], [t % 1000 for t in TIMES]
CLOCK = [f"12:{t // 60_000:02d}:{t // 1000 % 60:02d}" for t in TIMES]


@pytest.mark.parametrize(
    ("header", "coarse", "fine"),
    [
        ("Timestamp,Milliseconds", WHOLE, MILLI),
        ("secs,nsecs", WHOLE, [1_000_000 * t for t in MILLI]),
        ("time_s,time_us", WHOLE, [1000 * t for t in MILLI]),
        ("Date,ms", [f"2024-02-29 {text}" for text in CLOCK], MILLI),
        ("Timestamp,msec", CLOCK, MILLI),
        # The finer column continues beyond a second, so it is the complete time.
        ("time_s,time_ms", [t // 1000 for t in TIMES], [t - 59_000 for t in TIMES]),
    ],
)
@pytest.mark.parametrize("named", [False, True])
def test_a_finer_column_is_joined_to_a_coarse_one(
    header: str,
    coarse: list[object],
    fine: list[object],
    named: bool,  # noqa: FBT001 - of the case
    tmp_path: Path,
) -> None:
    """The name or a columns text identifies it. Whole seconds alone would give 100 equal stamps."""
    options = {"columns": "t=0+1,g=2:5"} if named else {}
    clock = recorded(tmp_path, header, coarse, fine, **options).series[0].clock
    assert clock.source in {f"column {header.replace(',', '+')}", "column time_ms"}
    assert clock.rate_hz == pytest.approx(100, rel=1e-9)
    assert (clock.n, clock.missing) == (N, 0)
    assert clock.jitter_s == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("coarse", "fine"),
    [
        (WHOLE, MILLI),
        (WHOLE, [1000 * t for t in MILLI]),
        (WHOLE, [1_000_000 * t for t in MILLI]),
        (WHOLE, [f"{t / 1000:.3f}" for t in MILLI]),
    ],
)
def test_unnamed_time_columns_are_joined(coarse: list[int], fine: list[object], tmp_path: Path) -> None:
    """The largest value below a second determines the unit of the fraction."""
    options = {"columns": "t=0+1,g=2:5", "gyro_unit": "rad/s"}
    path = tmp_path / "log.csv"
    path.write_text(lines("0,0,0,0,0", coarse, fine, *xyz(truth().gyro)).partition("\n")[2])
    clock = read(path, ReadOptions(**options)).series[0].clock  # type: ignore[arg-type]
    assert clock.rate_hz == pytest.approx(100, rel=1e-6)
    assert clock.missing == 0


@pytest.mark.parametrize(
    ("header", "times", "rate"),
    [
        ("gps_sow", [f"{345_600 + i * 0.005:.3f}" for i in range(N)], 200),
        ("sow", [f"{345_600 + i * 0.005:.3f}" for i in range(N)], 200),
        ("GPST", [f"{345_600 + i * 0.005:.3f}" for i in range(N)], 200),
        # A step is 0.1 ms; in us the counts would give 20 kHz, in ms 20 Hz.
        ("SampleTimeFine", [50 * i for i in range(N)], 200),
        ("tow", [f"{345_600 + i * 0.005:.3f}" for i in range(N)], 200),
        ("gps_tow_ms", [345_600_000 + 5 * i for i in range(N)], 200),
    ],
)
def test_known_names_determine_the_unit(
    header: str, times: list[object], rate: float, tmp_path: Path
) -> None:
    """Cases: times of the week, and ticks of Xsens."""
    clock = recorded(tmp_path, header, times).series[0].clock
    assert clock.rate_hz == pytest.approx(rate, rel=1e-6)
    assert clock.missing == 0


def test_the_unit_of_a_buffered_time_gives_the_mean_rate(tmp_path: Path) -> None:
    """Steps within a batch do not determine the unit."""
    times = [250 * (i // 25) + i % 25 for i in range(N)]
    (series, *_) = recorded(tmp_path, "t", times, time_unit="ms").series
    assert series.rate_hz == pytest.approx(100)
    fast = [100_000 * (i // 20) + 40 * (i % 20) for i in range(N)]
    recording = recorded(tmp_path, "t", fast)
    assert recording.series[0].rate_hz == pytest.approx(200)
    assert dict(recording.source.decisions)["time unit"].startswith("us for t, inferred")


def test_a_time_of_zero_is_a_valid_stamp(tmp_path: Path) -> None:
    """A device's clock may start at zero."""
    clock = recorded(tmp_path, "time_ms", [10 * i for i in range(N)]).series[0].clock
    assert (clock.start_ns, clock.n, clock.missing) == (0, N, 0)


def test_the_clock_can_be_chosen(tmp_path: Path) -> None:
    """Header stamps are the default; the recording time or any column can be requested."""
    path = tmp_path / "log.csv"
    path.write_text(rostopic(truth()), encoding="utf-8")
    assert read(path, ReadOptions()).series[0].clock.source == "column field.header.stamp"
    log = read(path, ReadOptions(time="log")).series[0].clock
    assert (log.source, log.start_ns) == ("column %time", EPOCH + 1_234_567)
    assert read(path, ReadOptions(time="%time")).series[0].clock.start_ns == EPOCH + 1_234_567


def test_zero_header_stamps_are_replaced_by_log_time(tmp_path: Path) -> None:
    """The driver sets no stamps; a finding reports that."""
    rows = rostopic(truth()).split("\n")
    zeroed = [
        ",".join([*row.split(",")[:2], "0", *row.split(",")[3:]]) if row[:1] == "1" else row for row in rows
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(zeroed), encoding="utf-8")
    recording = read(path, ReadOptions())
    assert recording.series[0].clock.start_ns == EPOCH + 1_234_567
    assert recording.series[0].rate_hz == pytest.approx(100)
    assert [finding.code for finding in recording.findings] == ["log-time-used"]


def test_repeated_rows_are_dropped(tmp_path: Path) -> None:
    """Some rows repeat the stamp and the values of their predecessor."""
    path = written(tmp_path, "time_ms", [10 * i for i in range(N)])
    rows = path.read_text(encoding="utf-8").split("\n")
    for place in (300, 200, 100):
        rows.insert(place, rows[place])
    path.write_text("\n".join(rows), encoding="utf-8")
    recording = read(path, ReadOptions())
    assert (recording.series[0].n, recording.series[0].clock.missing) == (N, 0)
    npt.assert_array_equal(recording.series[0].samples, truth().gyro[:, 0])


@pytest.mark.parametrize("times", [2, 4])
def test_samples_that_the_log_repeats_are_dropped(times: int, tmp_path: Path) -> None:
    """The log is written faster than the sensor samples; without its repeats it has the sensor's own rate."""
    path = written(tmp_path, "time_ms", [10 * i for i in range(N)])
    head, *rows = path.read_text(encoding="utf-8").rstrip("\n").split("\n")
    lines = []
    for place, row in enumerate(rows):
        values = row.partition(",")[2]
        lines += [f"{10 * place + 10 * part / times},{values}" for part in range(times)]
    path.write_text("\n".join([head, *lines, ""]), encoding="utf-8")
    recording = read(path, ReadOptions())
    assert recording.series[0].n == N
    assert recording.series[0].rate_hz == pytest.approx(100)
    found = [finding for finding in recording.findings if finding.code == "held-samples"]
    assert [(finding.level, finding.axis) for finding in found] == [("info", "gyro")]
    assert found[0].text.startswith(f"{(times - 1) * N} of {times * N} gyroscope samples repeat the previous")


def test_repeats_of_an_irregular_sensor_are_kept(tmp_path: Path) -> None:
    """Without a fifth of the rows, at random, the others are irregular: nothing shows their own times."""
    path = written(tmp_path, "time_ms", [10 * i for i in range(N)])
    head, *rows = path.read_text(encoding="utf-8").rstrip("\n").split("\n")
    values = [row.partition(",")[2] for row in rows]
    for place in np.flatnonzero(np.random.default_rng(3).random(N - 1) < 0.2) + 1:
        values[place] = values[place - 1]
    lines = [f"{10 * place},{value}" for place, value in enumerate(values)]
    path.write_text("\n".join([head, *lines, ""]), encoding="utf-8")
    recording = read(path, ReadOptions())
    assert recording.series[0].n == N
    assert "held-samples" not in {finding.code for finding in recording.findings}


def test_each_of_two_sensors_in_a_table_has_its_own_rate(tmp_path: Path) -> None:
    """The rows of one sensor repeat the last sample of the other, at 200 Hz and 62.5 Hz."""
    source = np.random.default_rng(8)
    times = [(i / 200, 0) for i in range(4000)] + [(i / 62.5 + 0.0007, 1) for i in range(1250)]
    gyro = 1e-2 * source.standard_normal((4000, 3))
    accel = 1e-2 * source.standard_normal((1250, 3)) + 9.81 / 3**0.5
    values = [gyro, accel]
    places = [0, 0]
    lines = ["time_s,gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"]
    for seconds, sensor in sorted(times):
        places[sensor] = round(seconds * (62.5 if sensor else 200.0) - 0.04 * sensor)
        row = (seconds, *values[0][places[0]], *values[1][places[1]])
        lines.append(",".join(f"{value:.9f}" for value in row))
    path = tmp_path / "log.csv"
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    recording = read(path, ReadOptions())
    rates = {series.sensor: series.rate_hz for series in recording.series}
    assert rates == pytest.approx({Sensor.GYROSCOPE: 200.0, Sensor.ACCELEROMETER: 62.5}, rel=1e-3)
    assert not [finding for finding in recording.findings if finding.level == "warning"]


def test_stamps_with_too_few_digits_are_refused_and_a_rate_replaces_them(tmp_path: Path) -> None:
    """In single precision, seconds since 1970 advance by 128 s."""
    stamps = np.float32(1.7e9 + np.arange(N) / 100).astype(np.float64)
    with raises(ChoiceError, "increases by 0 per row", place="log.csv", argument="time"):
        recorded(tmp_path, "timestamp", stamps)
    found = recorded(tmp_path, "timestamp", stamps, rate_hz=100.0)
    assert found.series[0].rate_hz == 100.0
    assert "time-unused" in {finding.code for finding in found.findings}


def psins(
    folder: Path, *, start: float, above: str = "1 2 3 1 1 1 0\n.9 .9 .9 .5 .5 .5 0\n0 0 0 0 0 0 0\n"
) -> Path:
    """Write a text whose first rows are initial values and scales with the time zero."""
    true = truth()
    values = np.column_stack([true.gyro, true.accel, start + np.arange(N) / 100])
    rows = "\n".join(" ".join(f"{value:.9g}" for value in row) for row in values)
    path = folder / "log.imu"
    path.write_text(f"% [gx, gy, gz, ax, ay, az, t]\n{above}{rows}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("start", [0.0, 0.01, 300.0])
def test_first_rows_that_repeat_a_stamp_are_no_samples(tmp_path: Path, start: float) -> None:
    """The last of them is a sample only if its values are like the others."""
    recording = read(psins(tmp_path, start=start), ReadOptions(gyro_unit="rad/s", accel_unit="m/s^2"))
    for sensor, values in ((Sensor.GYROSCOPE, truth().gyro), (Sensor.ACCELEROMETER, truth().accel)):
        for axis, series in enumerate(one for one in recording.series if one.sensor is sensor):
            npt.assert_allclose(series.samples, values[:, axis], rtol=1e-8)
            assert series.rate_hz == pytest.approx(100)
    (finding,) = [one for one in recording.findings if one.code == "first-rows"]
    assert (finding.level, finding.axis) == ("info", None)
    assert ": 3 of them are no samples" in finding.text


@pytest.mark.parametrize("repeated", [1, 2, 9])
def test_samples_with_the_same_stamp_as_the_first_are_kept_if_others_repeat_stamps(
    tmp_path: Path, repeated: int
) -> None:
    """A coarse clock, and one that starts late, are no reason to drop samples."""
    ticks = np.arange(N) // (repeated + 1)
    recording = recorded(tmp_path, "time_ms", 10 * (repeated + 1) * ticks)
    assert recording.series[0].n == N
    assert "first-rows" not in {finding.code for finding in recording.findings}

"""Clocks of tables: thresholds for repeated samples, declared rates, units and counters."""

import re

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError
from imucal.readers.read_options import ReadOptions
from imucal.readers.repeated_rows import sent_twice
from imucal.readers.sensor_rows import SensorRows
from imucal.readers.table_clock import _compare_rates, table_clock
from imucal.readers.tables.columns import Triad
from imucal.readers.tables.names import parse_column
from imucal.readers.tables.plan import SensorPlan
from imucal.readers.tables.stamps import Numbers, TimeChoice
from imucal.readers.work import Work
from imucal.recording import Sensor

GYRO = Triad(
    sensor=Sensor.GYROSCOPE,
    columns=tuple(parse_column(f"g{axis}", at) for at, axis in enumerate("xyz", start=1)),
)
COUNTER = TimeChoice(kind="counter", indices=(0,), name="seq")
MS = TimeChoice(kind="stamp", indices=(0,), name="t", ns=1_000_000, ns_source="by hand")


def work(given: float | None = None) -> Work:
    return Work(options=ReadOptions(rate_hz=given))


def columns(
    time: TimeChoice | None, values: Numbers, still: int = 0, rate_hz: float | None = None
) -> SensorRows:
    """Return increasing samples; the last `still` of them are constant."""
    n = values.size
    axis = np.minimum(np.arange(n, dtype=np.float64), n - 1 - still)
    return SensorRows(
        plan=SensorPlan(triad=GYRO, time=time),
        axes=[axis] * 3,
        time=[values],
        place="log.csv",
        rate_hz=rate_hz,
    )


@pytest.mark.parametrize(("still", "marked", "found"), [(0, 0, 0), (1, 1, 0), (2, 2, 0), (3, 0, 1)])
def test_up_to_a_tenth_of_repeated_rows_is_marked(still: int, marked: int, found: int) -> None:
    """Above that share the sensor is slower than its log, and a finding reports held samples."""
    stamps = np.minimum(np.arange(20), 19 - still).astype(np.int64)
    at = work()
    same = sent_twice(at, stamps, columns(MS, stamps, still))
    assert (0 if same is None else int(same.sum())) == marked
    assert [finding.code for finding in at.findings] == ["held-samples"] * found


def test_rows_with_equal_stamps_and_different_values_are_not_repeated() -> None:
    stamps = np.array([0, 1, 2, 2], dtype=np.int64)
    at = work()
    assert sent_twice(at, stamps, columns(MS, stamps)) is None
    assert not at.findings


@pytest.mark.parametrize(
    ("stated", "given", "differs"),
    [
        (100.0, None, True),
        (101.5, None, False),
        (106.0, None, True),
        (100.0, 100.0, False),
        (None, None, False),
    ],
)
def test_a_wrong_declared_rate_is_reported(
    stated: float | None,
    given: float | None,
    differs: bool,  # noqa: FBT001
) -> None:
    """The rate must differ by 2 %. No finding is needed if the user gave a rate."""
    at = work(given)
    _compare_rates(at, stated, 103.0)
    texts = (
        [f"The log declares {stated:g} Hz, its time stamps give 103 Hz; the time stamps are used."]
        if differs
        else []
    )
    assert [finding.text for finding in at.findings] == texts


@pytest.mark.parametrize("first", [0, 5])
def test_a_clock_starts_where_its_stamps_do(first: int) -> None:
    """A first stamp of zero is valid."""
    at = work()
    reading = table_clock(at, columns(MS, np.arange(first, first + 500, 5, dtype=np.int64)))
    assert reading.clock.start_ns == first * 1_000_000
    npt.assert_allclose(reading.clock.rate_hz, 200.0, rtol=1e-9)
    assert at.decisions == [("time unit", "ms for t, by hand"), ("time", "column t, stamps")]


def test_a_unit_without_a_name_is_a_number_of_one_with_a_name() -> None:
    """12 500 000 ns are 12 500 us."""
    at = work()
    ticks = TimeChoice(kind="stamp", indices=(0,), name="t", ns=12_500_000, ns_source="by hand")
    table_clock(at, columns(ticks, np.arange(1, 101, dtype=np.int64)))
    assert at.decisions[0] == ("time unit", "12500 us for t, by hand")


def test_a_column_that_increases_by_one_counts_samples_at_the_given_rate() -> None:
    """Without a given rate, its unit is required."""
    plain = TimeChoice(kind="stamp", indices=(0,), name=" t ")
    counts = np.arange(1, 101, dtype=np.int64)
    at = work(given=250.0)
    assert table_clock(at, columns(plain, counts)).clock.rate_hz == 250.0
    assert at.decisions[0] == ("time unit", " t  counts samples at the given rate")
    text = (
        "log.csv: column ' t ', the time of the gyroscope, has no unit and increases by 1 per row, which "
        "is 1000 Hz in ms or 1 Hz in s; give the time unit, name it in the header, such as t_ms, or "
        "give the sampling rate"
    )
    with pytest.raises(ChoiceError, match=f"^{re.escape(text)}$"):
        table_clock(work(), columns(plain, counts))


@pytest.mark.parametrize(("every", "used"), [(10, True), (9, False)])
def test_nine_of_ten_steps_of_a_counter_must_be_one(every: int, used: bool) -> None:  # noqa: FBT001 - of the case
    """With fewer steps of one, only the rate is used, and a finding reports that."""
    steps = np.ones(90, dtype=np.int64)
    steps[::every] = 2
    at = work(given=100.0)
    reading = table_clock(at, columns(COUNTER, np.concatenate([[0], np.cumsum(steps)])))
    assert [finding.code for finding in at.findings] == ([] if used else ["counter-unused"])
    assert reading.clock.start_ns is None
    assert at.decisions == [("time", "100 Hz, the given rate")]


@pytest.mark.parametrize(("time", "what"), [(None, "no time column"), (COUNTER, "only a counter (seq)")])
def test_a_table_without_time_and_rate_is_refused(time: TimeChoice | None, what: str) -> None:
    text = (
        f"log.csv: {what} and no sampling rate for the gyroscope; expected time stamps or a rate; "
        "give the sampling rate"
    )
    with pytest.raises(ChoiceError, match=f"^{re.escape(text)}$"):
        table_clock(work(), columns(time, np.arange(10, dtype=np.int64)))


def test_the_declared_rate_replaces_a_missing_time() -> None:
    at = work()
    reading = table_clock(at, columns(None, np.arange(10, dtype=np.int64), rate_hz=50.0))
    assert (reading.clock.rate_hz, reading.clock.source) == (50.0, "rate in the log")
    assert at.decisions == [("time", "50 Hz, the rate in the log")]


@pytest.mark.parametrize(
    ("stamps", "start", "source"),
    [
        ([0, 5, 10, 15, 20, 25], 0, "column t"),
        ([3, 5, 10, 15, 20, 25], 3, "column t"),
    ],
)
def test_a_clock_that_starts_at_zero_is_valid(stamps: list[int], start: int, source: str) -> None:
    """The first sample is kept, because zero is not a missing stamp here."""
    reading = table_clock(work(), columns(MS, np.array(stamps, dtype=np.int64)))
    assert reading.clock.start_ns == start * 1_000_000
    assert reading.clock.source == source
    assert (reading.order is None, reading.clock.n) == (True, len(stamps))

"""Values are rounded according to their interval, and a printed bound is never too small."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucal.fitting.noise_fit import Estimate
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.numbers import Quantity, compact, decimals, sheet_units, with_uncertainty
from imucal.units import data_size, duration
from tests.report.synthetic import consumer_report


def _quantity(value: float | None, low: float, high: float, unit: str = "deg/h") -> Quantity:
    return Quantity(value=value, low=low, high=high, unit=unit)


@pytest.mark.parametrize(
    ("high", "places"), [(0.0994, 3), (0.0996, 2), (0.996, 1), (9.94, 1), (9.96, 0), (99.6, -1), (0.01, 3)]
)
def test_rounding_up_to_the_next_decade_removes_a_digit(high: float, places: int) -> None:
    """Two digits of 0.0996 are 0.10, those of 9.96 are 10."""
    assert decimals(_quantity(None, 0.0, high)) == places


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        # The three cases of the Particle Data Group's rule (Review 2022, sec. 5.3).
        (0.827, 0.119, "0.83 ± 0.12 deg/h"),
        (8.27, 0.367, "8.3 ± 0.4 deg/h"),
        (0.8273, 0.0099, "0.827 ± 0.010 deg/h"),
        (12.1, 0.36, "12.1 ± 0.4 deg/h"),
        (12.1, 0.35, "12.10 ± 0.35 deg/h"),
        (90.0, 20.0, "90 ± 20 deg/h"),
        (1500.0, 320.0, "1500 ± 320 deg/h"),
        (1234567.0, 20000.0, "1235000 ± 20000 deg/h"),
        (1.2e-4, 3e-6, "0.0001200 ± 0.0000030 deg/h"),
        (-2.0e-7, 1e-8, "-2.0e-7 ± 1.0e-8 deg/h"),
    ],
)
def test_the_uncertainty_determines_the_digits(value: float, half: float, text: str) -> None:
    """An uncertainty has two digits up to 355 and otherwise one; the value has at least two."""
    assert with_uncertainty(_quantity(value, value - half, value + half)) == text


@pytest.mark.parametrize(
    ("quantity", "text"),
    [
        (_quantity(12.1, 11.4, 13.9), "12.1 [11.4, 13.9] deg/h"),
        (_quantity(None, 0, 0.1149, "deg/h/sqrt(h)"), "< 0.12 deg/h/√h"),
        (_quantity(None, 0, 0.12), "< 0.12 deg/h"),
        (_quantity(None, 0, 4.1e-7, "rad/s/sqrt(s)"), "< 4.1 ×10⁻⁷ rad/s/√s"),
        (_quantity(None, 0, 9.91), "< 10.0 deg/h"),
        (_quantity(None, 0, math.inf), "unknown deg/h"),
        (_quantity(3.2, 1.1, math.inf), "3.2 [1.1, ?] deg/h"),
        (_quantity(3.587, 3.587, 3.587), "3.587 deg/h"),
        (_quantity(0.066, 0.066, 0.066, "m/s^2"), "0.06600 m/s²"),
        (_quantity(0.099996, 0.099996, 0.099996), "0.1000 deg/h"),
    ],
)
def test_asymmetric_bounded_and_unknown_values_are_printed_differently(quantity: Quantity, text: str) -> None:
    """Intervals replace a misleading ±, and bounds are rounded up."""
    assert with_uncertainty(quantity) == text


@given(high=st.floats(1e-12, 1e12))
def test_a_printed_bound_is_never_below_the_bound(high: float) -> None:
    """The printed value is at most 10 % above the bound."""
    text, interval = compact(_quantity(None, 0.0, high))
    printed = float(text.removeprefix("< "))
    assert interval == ""
    # The factor allows for the error of the decimal fraction.
    assert high * (1 - 1e-11) <= printed <= high * 1.1


@given(
    value=st.floats(1e-9, 1e9),
    below=st.floats(1e-4, 0.9),
    above=st.floats(1e-4, 5.0),
)
def test_rounding_keeps_the_digits_that_the_interval_supports(
    value: float, below: float, above: float
) -> None:
    """The rounding error is small compared with the width of the interval."""
    quantity = _quantity(value, value * (1 - below), value * (1 + above))
    exponent = numbers.power_of_ten(quantity)
    text, interval = compact(quantity, exponent=exponent)
    half = (quantity.high - quantity.low) / 2
    assert abs(float(text) * 10.0**exponent - value) <= max(half / 3, 1e-4 * value)
    low, high = interval.strip("[]").split(", ")
    assert float(low) <= float(text) <= float(high)


def test_a_drawn_bounded_term_is_reported() -> None:
    """The drawn value has the unit and digits of its row, in tables and pictures."""
    bound = replace(_quantity(None, 0, 4.7e-6), in_model=2.5e-6)
    assert compact(bound, exponent=-6) == ("< 4.7", "(model: 2.5)")
    assert with_uncertainty(bound.scaled(1e6, "deg/h")) == "< 4.7 (model: 2.5) deg/h"
    found = Estimate(key="K", symbol="K", status="bounded", value=None, low=0, high=4.7e-6, in_model=2.5e-6)
    assert numbers.si(found, Sensor.GYROSCOPE).in_model == 2.5e-6
    shown = replace(found, status="estimated", value=2.5e-6)
    assert numbers.si(shown, Sensor.GYROSCOPE).in_model is None


def test_a_walk_that_may_be_a_gauss_markov_term_has_a_minimum_t() -> None:
    """The text contains the smallest T of a Gauss-Markov term that could replace the walk."""
    k = Estimate(key="K", symbol="K", status="bounded", value=None, low=0.0, high=1.0)
    assert numbers.alternatives(k) == ""
    assert numbers.alternatives(replace(k, alternatives=("B", "GM"))) == "or B or GM"
    assert numbers.alternatives(replace(k, alternatives=("GM",), horizon_s=312.3)) == "or GM, T > 312 s"


def test_numbers_of_a_row_share_an_exponent() -> None:
    """The exponent is a multiple of three and fits the largest number."""
    limits = ((1.1e-6, 1e-6, 1.2e-6), (None, 0.0, 4e-7), (3e-9, 2e-9, 4e-9))
    row = [_quantity(value, low, high, "rad/s") for value, low, high in limits]
    assert numbers.engineering_exponent(row) == -6
    assert compact(row[0], exponent=-6) == ("1.10", "[1.00, 1.20]")
    assert compact(row[2], exponent=-6) == ("0.0030", "[0.0020, 0.0040]")
    assert numbers.engineering_exponent([_quantity(0.4, 0.3, 0.5, "rad/s")]) == 0
    assert numbers.engineering_exponent([_quantity(None, 0, math.inf, "rad/s")]) == 0
    assert numbers.engineering_exponent([replace(q, unit="deg/h") for q in row]) == 0


def test_numbers_far_from_their_row_have_an_exponent() -> None:
    """Zeros are avoided for an interval over fifteen decades, or a bound far above the values."""
    assert compact(_quantity(120, 0.6, 2.9134e15)) == ("120", "[0, 2.9134e15]")
    assert compact(_quantity(5.3e-13, 1e-14, 5.1e-10)) == ("5.3e-13", "[1.0e-14, 5.1e-10]")
    assert compact(_quantity(None, 0, 1.5123e16)) == ("< 1.6e16", "")
    assert compact(_quantity(None, 0, 8.2e-9)) == ("< 8.2e-9", "")
    row = [_quantity(None, 0, 1.6e16), _quantity(530, 500, 560)]
    assert numbers.engineering_exponent(row) == 0


def test_data_sheet_units_are_those_of_the_field() -> None:
    """1e-4 rad/s/√Hz is 0.34377 deg/√h, 9.80665e-3 m/s² is 1 mg, and less than 0.1 mg is given in µg."""
    noise = Estimate(key="N", symbol="N", status="estimated", value=1e-4, low=9e-5, high=1.1e-4)
    assert numbers.datasheet(noise, Sensor.GYROSCOPE).value == pytest.approx(0.343775, rel=1e-5)
    assert numbers.si(noise, Sensor.GYROSCOPE).unit == "rad/s/sqrt(Hz)"
    floor = Estimate(key="B", symbol="B", status="estimated", value=9.80665e-3, low=9e-3, high=1.1e-2)
    sheet = numbers.datasheet(floor, Sensor.ACCELEROMETER)
    assert sheet.unit == "ug"
    assert sheet.value == pytest.approx(1000.0)


@pytest.mark.parametrize("times", [1.0, 20.0])
def test_all_levels_of_a_sensor_have_the_same_unit(times: float) -> None:
    """The unit of B, sigma and minimum is micro-g for any size, axis and log."""
    unit = "ug"
    report = consumer_report()
    accel = [axis for axis in report.axes if axis.sensor is Sensor.ACCELEROMETER]
    loud = accel[0].fit.curve
    loud = replace(loud, avar=loud.avar * times**2)
    first = replace(accel[0], fit=replace(accel[0].fit, curve=loud))
    units = sheet_units([first.fit, *(axis.fit for axis in accel[1:])])
    assert units.level.name == unit
    factor = 1e6 / 9.80665
    assert units.level.factor == pytest.approx(factor)
    for axis in accel:
        assert {units.minimum(axis.fit).unit, units.estimate(axis.fit["B"], axis.sensor).unit} == {unit}
        assert units.minimum(axis.fit).value == pytest.approx(axis.fit.curve.minimum[0] * factor)
        assert units.estimate(axis.fit["N"], axis.sensor).unit == "m/s/sqrt(h)"
    assert sheet_units([axis.fit for axis in report.axes[:3]]).level.name == "deg/h"


def test_the_minimum_has_the_interval_of_its_point() -> None:
    """The minimum is inside, and both units agree."""
    for axis in consumer_report().axes:
        plain, sheet = numbers.minimum(axis.fit), sheet_units([axis.fit]).minimum(axis.fit)
        assert plain.value is not None
        assert plain.low < plain.value < plain.high
        assert sheet.low / plain.low == pytest.approx(sheet.high / plain.high)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0 s"),
        (7.512, "7.51 s"),
        (20, "20 s"),
        (59.97, "1 min"),
        (720, "12 min"),
        (740.4, "12 min 20 s"),
        (3599.6, "1 h"),
        (10800, "3 h"),
        (10920, "3 h 2 min"),
        (47.9 * 3600, "47 h 54 min"),
        (50 * 3600, "2 d 2 h"),
        (3 * 86400, "3 d"),
    ],
)
def test_durations_have_readable_units(seconds: float, text: str) -> None:
    """Durations have at most two units; a smaller unit of zero is omitted."""
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.712, "0.71 s"),
        (59.6, "1 min"),
        (740.4, "12 min"),
        (6.2 * 3600, "6 h 10 min"),
        (281, "4 min 40 s"),
        (9.4 * 60, "9 min 25 s"),
        (9.6 * 3600, "10 h"),
        (30.6 * 3600, "31 h"),
        (4.01 * 86400, "4 d"),
        (400.4 * 86400, "400 d"),
    ],
)
def test_rough_durations_have_two_digits(seconds: float, text: str) -> None:
    """The smaller unit is omitted from ten of the larger one; it is a multiple of 5 s, 5 min or 2 h."""
    assert duration(seconds, rough=True) == text


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (0, "0 kB"),
        (26_730, "26.73 kB"),
        (10**6, "1 MB"),
        (224_000_000, "224 MB"),
        (13_440_000_000, "13.44 GB"),
        (22_400_000_000_000, "22.4 TB"),
    ],
)
def test_sizes_have_no_exponent(size: int, text: str) -> None:
    """The number of digits is limited too."""
    assert data_size(size) == text


@pytest.mark.parametrize(("value", "text"), [(2621.44, "2620 s"), (0.005, "0.005 s"), (41.3, "41.3 s")])
def test_times_have_three_digits_and_no_exponent(value: float, text: str) -> None:
    """The form 2.62e+03 s is unusual in text."""
    assert numbers.seconds(value) == text


@pytest.mark.parametrize(
    ("size", "power", "shared"),
    [
        (0.00999, -3, -3),
        (0.01, 0, 0),
        (99_999.0, 0, 0),
        (1e5, 5, 3),
        (5.4e-4, -4, -3),
        (1.2e-4, -4, -6),
        (3.2e-4, -4, -3),
        (3.1e8, 8, 6),
        (3.2e8, 8, 9),
        (0.0, 0, 0),
        (math.inf, 0, 0),
    ],
)
def test_powers_of_ten_are_used_below_0_01_and_from_100_000_on(size: float, power: int, shared: int) -> None:
    """The shared exponent changes at half a decade, as between 0.54e-3 and 120e-6."""
    for unit, used in (("rad/s", 1), ("deg/h", 0)):
        assert numbers.power_of_ten(_quantity(-size, -size, -size, unit)) == power * used
        row = [_quantity(None, 0, size, unit), _quantity(None, 0, size / 3, unit)]
        assert numbers.engineering_exponent(row) == shared * used


@pytest.mark.parametrize(
    ("quantity", "places"),
    [
        (_quantity(0.0, 0.0, 0.0), 0),
        (_quantity(None, 0.0, math.inf), 0),
        (_quantity(3.2, -math.inf, math.inf), 1),
        (_quantity(2.0, 2.0, 2.0), 3),
        # If half the interval is below 1e-4 of the value there are five digits; otherwise the interval
        # decides.
        (_quantity(2.0, 2.0 - 1.9e-4, 2.0 + 1.9e-4), 4),
        (_quantity(2.0, 2.0 - 2.1e-4, 2.0 + 2.1e-4), 5),
        (_quantity(2.0, 2.0 - 3.6e-4, 2.0 + 3.6e-4), 4),
        # The value has at least two digits, even with a wide interval.
        (_quantity(0.031, -4.0, 4.0), 3),
    ],
)
def test_the_interval_determines_the_decimal_places(quantity: Quantity, places: int) -> None:
    """Without an interval, or with one of zero width, the value determines them."""
    assert decimals(quantity) == places


@pytest.mark.parametrize(
    ("quantity", "texts"),
    [
        (_quantity(1_234_567_890.0, 1_234_567_890.0, 1_234_567_890.0), ("1235000000", "")),
        (_quantity(12_345_678_901.0, 12_345_678_901.0, 12_345_678_901.0), ("1.235e10", "")),
        (_quantity(None, 0.0, 0.0), ("0", "")),
        # A limit that rounds to zero has no sign.
        (_quantity(0.5, -0.001, 1.001), ("0.50", "[0.00, 1.00]")),
        (_quantity(-0.5, -1.5, 0.5), ("-0.50", "[-1.50, 0.50]")),
    ],
)
def test_numbers_longer_than_ten_characters_have_an_exponent(
    quantity: Quantity, texts: tuple[str, str]
) -> None:
    assert compact(quantity) == texts


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (6.0, 15.0, "10 [6, 15] deg/h"),
        (5.0, 14.0, "10 [5, 14] deg/h"),
        (6.0, 14.9, "10 ± 4 deg/h"),
        (5.1, 14.0, "10 ± 4 deg/h"),
        (10.0, 12.0, "10.0 [10.0, 12.0] deg/h"),
    ],
)
def test_asymmetric_limits_are_both_printed(low: float, high: float, text: str) -> None:
    """Sides of 4 and 5 differ by a quarter and are asymmetric, 4 and 4.9 are not."""
    assert with_uncertainty(_quantity(10.0, low, high)) == text


def test_a_minimum_with_unknown_degrees_of_freedom_has_no_interval() -> None:
    """With very few degrees of freedom the upper limit is infinite."""
    axis = consumer_report().axes[0]
    for edf in (1e-3, math.nan):
        curve = replace(axis.fit.curve, edf=np.full(axis.fit.curve.tau.size, edf))
        with np.errstate(divide="ignore"):
            plain = numbers.minimum(replace(axis.fit, curve=curve))
        assert plain.low == plain.value == plain.high

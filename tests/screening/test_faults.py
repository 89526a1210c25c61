"""Tests of faults in a log at rest: each is found and described, without other findings."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.findings import Finding
from imucal.grading import grade_of
from imucal.pipeline import screen
from imucal.screening import screen_values
from imucal.units import G0
from tests.screening.still import recording, still

pytestmark = pytest.mark.usefixtures("axes_are_screened_once")

N = 20_000
T = np.arange(N) / 100.0
Tables = tuple[FloatArray, FloatArray]


def found(gyro: FloatArray, accel: FloatArray, temperature: FloatArray | None = None) -> tuple[Finding, ...]:
    return tuple(f for f in screen(recording(gyro, accel, temperature=temperature)) if f.code != "roll-off")


def at_rest(gyro: FloatArray, accel: FloatArray) -> tuple[Finding, ...]:
    """Return the findings about values and rest, without those of `not_noise`."""
    return screen_values(recording(gyro, accel))


def one(findings: tuple[Finding, ...]) -> Finding:
    assert len(findings) == 1, [f.text for f in findings]
    return findings[0]


def as_it_is(gyro: FloatArray, accel: FloatArray) -> Tables:
    return gyro, accel


def knocked(gyro: FloatArray, accel: FloatArray) -> Tables:
    accel[:, 9000:9020] += 0.3 * np.sin(np.arange(20))
    return gyro, accel


def picked_up(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[:, :300] += 0.3 * np.sin(9 * T[:300])
    return gyro, accel


def put_away(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[:, -200:] += 0.1
    return gyro, accel


def handled(gyro: FloatArray, accel: FloatArray) -> Tables:
    for start in range(2000, 18_000, 2000):
        gyro[0, start : start + 900] += 0.05 * np.sin(5 * T[:900])
    return gyro, accel


def turned(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[0, 9000:9100] += np.pi / 2
    accel[2, 9000:] -= G0
    accel[1, 9000:] += G0
    return gyro, accel


def held(gyro: FloatArray, accel: FloatArray) -> Tables:
    from scipy.signal import butter, sosfilt

    rng = np.random.default_rng(5)
    shake = sosfilt(butter(2, [1, 6], "bandpass", fs=100, output="sos"), 0.03 * rng.normal(size=(3, N)))
    return gyro + shake, accel


def carried_without_gravity(gyro: FloatArray, accel: FloatArray) -> Tables:
    from scipy.signal import butter, sosfilt

    rng = np.random.default_rng(6)
    steps = sosfilt(butter(2, 3, fs=100, output="sos"), 4 * rng.normal(size=(3, N)))
    accel[2] -= G0
    return gyro, accel + steps


def in_sixteenths(gyro: FloatArray, accel: FloatArray) -> Tables:
    return np.round(np.degrees(gyro) * 16) / 16, accel


def tilted(gyro: FloatArray, accel: FloatArray) -> Tables:
    accel[0, 12_000:] += 0.02
    return gyro, accel


def warming(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[2] += 2e-3 * np.exp(-T / 20)
    return gyro, accel


def still_warming(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[2] += 6e-3 * np.exp(-T / 60)
    return gyro, accel


def stuck(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[1, 500:900] = gyro[1, 500]
    return gyro, accel


def dead(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[1] = 0.1
    return gyro, accel


def unfilled(gyro: FloatArray, accel: FloatArray) -> Tables:
    accel[0] = 0
    return gyro, accel


def without_finite(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[0] = np.nan
    return gyro, accel


def broken(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[0, ::400] = np.nan
    gyro[0, 7] = -1e300
    return gyro, accel


def clipped(gyro: FloatArray, accel: FloatArray) -> Tables:
    accel[2] = np.minimum(np.round(accel[2], 3), 9.84)
    return gyro, accel


def coarse(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[0] = np.round(gyro[0] / 4e-3) * 4e-3
    return gyro, accel


def in_g(gyro: FloatArray, accel: FloatArray) -> Tables:
    return gyro, accel / G0


def in_mg(gyro: FloatArray, accel: FloatArray) -> Tables:
    return gyro, accel / G0 * 1e3


def in_deg(gyro: FloatArray, accel: FloatArray) -> Tables:
    return np.degrees(gyro), accel


def in_deg_of_131(gyro: FloatArray, accel: FloatArray) -> Tables:
    return np.round(np.degrees(gyro) * 131) / 131, accel


def as_counts(gyro: FloatArray, accel: FloatArray) -> Tables:
    return np.round(np.degrees(gyro) * 131), accel


def biased_in_deg(gyro: FloatArray, accel: FloatArray) -> Tables:
    return gyro + 0.5, accel


def swapped(gyro: FloatArray, accel: FloatArray) -> Tables:
    return accel, gyro


def copied(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[2] = 0.1 - gyro[0]
    return gyro, accel


def humming(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[2] += 1e-3 * np.sin(2 * np.pi * 31.25 * T)
    return gyro, accel


def repeated(gyro: FloatArray, accel: FloatArray) -> Tables:
    return np.repeat(gyro[:, ::2], 2, axis=1), accel


def filled_in(gyro: FloatArray, accel: FloatArray) -> Tables:
    gyro[:, 10:-1:20] = (gyro[:, 9:-2:20] + gyro[:, 11::20]) / 2
    return gyro, accel


def weightless(gyro: FloatArray, accel: FloatArray) -> Tables:
    accel[2] -= G0
    return gyro, accel


#: Fault -> level, code, axis and complete text of its finding.
Fault = Callable[[FloatArray, FloatArray], Tables]
FAULTS: list[tuple[Fault, str, str, str | None, str]] = [
    (knocked, "warning", "touch", None,
     ("Something touched or shook the IMU once: 90.0 to 90.5 s (accel_x, accel_y and accel_z; "
     "7 times the noise).")),
    (picked_up, "error", "motion", None,
     ("The IMU was moved near the start of the log: 0.0 to 3.5 s (gyro_x, gyro_y and gyro_z; "
     "160 times the noise).")),
    (put_away, "warning", "motion", None,
     ("The IMU was moved near the end of the log: 197.5 to 198.5 s (gyro_x, gyro_y and gyro_z; "
     "a shift of the level).")),
    (handled, "error", "motion", None,
     ("The IMU was not at rest: it moved 8 times, 40% of the log; the longest rest "
     "is 29.5 s.")),
    (turned, "error", "motion", None,
     "The IMU was turned by up to 90 degrees, mostly near 89.0 s: the direction of gravity changes."),
    (held, "error", "motion", None,
     ("The IMU was not at rest: gyro_y moves by 0.00982 rad/s (0.562 deg/s) rms between 0.5 and 10 Hz, "
     "as in a hand or on a running machine.")),
    (carried_without_gravity, "error", "motion", None,
     ("The IMU was not at rest: accel_x has a standard deviation of 1.05 m/s^2 (107 mg), and the "
     "accelerometer shows no gravity.")),
    (tilted, "warning", "step", "accel_x",
     "The level jumps by +0.0196 m/s² at 120.0 s and stays there."),
    (warming, "warning", "warm-up", "gyro_z",
     "The axis settles exponentially, with a time constant of 22.2 s: a warm-up."),
    (still_warming, "warning", "warm-up", "gyro_z",
     "The axis settles exponentially, with a time constant of 64.5 s: a warm-up."),
    (stuck, "warning", "stuck", "gyro_y", "The axis is stuck at one value for 4 s in all, first at 5.0 s."),
    (dead, "error", "stuck", "gyro_y", "The axis never changes: all 20000 samples are 0.1 rad/s."),
    (unfilled, "error", "no-data", "accel_x",
     "All 20000 samples are 0: the driver does not fill this axis."),
    (without_finite, "error", "no-data", "gyro_x", "No sample is finite."),
    (broken, "warning", "not-finite", "gyro_x",
     ("51 samples (0.0026 of all) are NaN, infinite or absurdly large "
     "and left out.")),
    (clipped, "warning", "saturated", "accel_z",
     "The axis is at its highest value, 9.84 m/s^2 (1003 mg), 1024 times: it is saturated, first at 0.0 s."),
    (coarse, "warning", "coarse-lsb", "gyro_x",
     ("The steps of the axis, 0.004 rad/s (0.229 deg/s), are coarse: its noise is about 0.4 LSB, and "
     "rounding distorts N and hides slow changes.")),
    (in_g, "warning", "unit-suspect", "accel",
     "|a| is 1 at rest, expected 9.8 in m/s^2: the unit looks like g."),
    (in_mg, "warning", "unit-suspect", "accel",
     "|a| is 1000 at rest, expected 9.8 in m/s^2: the unit looks like mg."),
    (in_deg, "warning", "unit-suspect", "gyro",
     ("The gyroscope may not be in rad/s: its noise, 0.0086 rad/s/sqrt(Hz), is more than gyroscopes have; "
     "in deg/s it would be 0.00015 rad/s/sqrt(Hz).")),
    (in_sixteenths, "warning", "unit-suspect", "gyro",
     "The gyroscope may not be in rad/s: its steps of 0.0625 are a usual LSB in deg/s."),
    (in_deg_of_131, "warning", "unit-suspect", "gyro",
     "The gyroscope may not be in rad/s: its steps of 0.0076336 are a usual LSB in deg/s."),
    (as_counts, "warning", "unit-suspect", "gyro",
     "The gyroscope may not be in rad/s: all its values are whole numbers, like raw counts."),
    (biased_in_deg, "warning", "unit-suspect", "gyro",
     "The gyroscope may not be in rad/s: it shows 0.87 at rest, 50 deg/s if in rad/s."),
    (swapped, "error", "swapped-sensors", None,
     ("The gyroscope shows 9.81 at rest, like gravity, and the accelerometer 0.011: the two are swapped, "
      "or the gyroscope's columns are the direction of gravity.")),
    (copied, "error", "duplicate-axes", None,
     "gyro_x and gyro_z contain the same samples with opposite sign (correlation -1.000)."),
    (humming, "warning", "tone", "gyro_z",
     ("The axis has a tone, which bends the Allan curve: 0.00102 rad/s (0.0586 deg/s) at 31.25 Hz, "
     "perhaps a fan or motor at 1875 rpm, or a folded higher tone.")),
    (repeated, "warning", "held-samples", "gyro",
     ("50.0% of the gyroscope samples repeat the previous one on all axes: the log has 100 samples "
     "per second, about 50 of them new.")),
    (filled_in, "warning", "interpolated-samples", "gyro",
     ("5.0% of the gyroscope samples are exactly midway between their neighbours on all axes: the driver or "
     "a converter has interpolated lost samples.")),
    (weightless, "warning", "no-gravity", "accel",
     "The accelerometer shows no gravity: |a| is 0.0045 m/s^2."),
]  # fmt: skip


@pytest.mark.parametrize(
    ("fault", "level", "code", "axis", "text"), FAULTS, ids=[fault[0].__name__ for fault in FAULTS]
)
def test_a_fault_is_found_and_reported(
    fault: Fault, level: str, code: str, axis: str | None, text: str
) -> None:
    """Each fault has one finding with its figures."""
    look = at_rest if code == "motion" else found
    finding = one(look(*fault(*still(N, 1))))
    assert (finding.level, finding.code, finding.axis) == (level, code, axis)
    assert finding.text == text


@pytest.mark.parametrize(
    ("fault", "keep"),
    [(knocked, (91.5, 200.0)), (picked_up, (4.5, 200.0)), (put_away, (0.0, 196.5)), (tilted, (0.0, 120.0)),
     (warming, (66.7, 200.0)), (stuck, (9.0, 200.0)), (turned, (92.5, 200.0))],
)  # fmt: skip
def test_the_part_without_the_fault_is_suggested(fault: Fault, keep: tuple[float, float]) -> None:
    """It is the longest part at least a second away from the fault; the log is 200 s long."""
    look = at_rest if fault is put_away else found
    assert one(look(*fault(*still(N, 1)))).keep_s == keep


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("fault", "kinds"),
    [
        (knocked, ("flicker", "random walk")),
        (picked_up, ("flicker", "random walk")),
        (stuck, ("flicker", "random walk")),
        (clipped, ("flicker", "random walk")),
        (coarse, ("flicker", "random walk")),
        (humming, ("flicker", "random walk")),
        # Flicker noise and random walks of that strength drift equally far.
        (tilted, ("white", "rounded")),
        (warming, ("white", "rounded")),
    ],
)
def test_faults_are_found_in_other_noise(fault: Fault, kinds: tuple[str, ...], seed: int) -> None:
    """Only the axes with the fault are screened."""
    code = next(row[2] for row in FAULTS if row[0] is fault)
    # Disturbances are searched by axis; all other findings are about the values.
    look = screen if code in {"step", "warm-up", "tone"} else screen_values
    for kind in kinds:
        original, faulty = (recording(*make(*still(N, 100 + seed, kind))) for make in (as_it_is, fault))
        pairs = zip(original.series, faulty.series, strict=True)
        touched = [after for before, after in pairs if not np.array_equal(before.samples, after.samples)]
        assert code in {f.code for f in look(replace(faulty, series=tuple(touched)))}


def test_the_suggested_part_has_no_finding() -> None:
    log = recording(*picked_up(*still(N, 3)))
    keep = one(screen(log)).keep_s
    assert keep is not None
    cut = tuple(series.between(*keep) for series in log.series)
    assert screen(replace(log, series=cut)) == ()


def test_temperature_dependence_is_found_with_its_slope() -> None:
    """Only the dependent axis is reported."""
    warmth = 30 + 5 * (1 - np.exp(-T / 60)) + 0.02 * np.random.default_rng(0).normal(size=N)
    gyro, accel = still(N, 1)
    gyro[2] += 5e-4 * (warmth - 30)
    (finding,) = (f for f in found(gyro, accel, warmth) if f.code == "temperature" and f.axis)
    assert finding.axis == "gyro_z"
    assert finding.level == "warning"
    assert finding.text == "The axis follows the temperature (0.000498 rad/s per degree C)."


def test_a_large_change_of_temperature_is_reported() -> None:
    """No axis follows it, so the level is info."""
    warmth = 30 + 5 * (1 - np.exp(-T / 60)) + 0.02 * np.random.default_rng(0).normal(size=N)
    finding = one(found(*still(N, 1), warmth))
    assert (finding.level, finding.code, finding.axis) == ("info", "temperature", None)
    assert finding.text == "The temperature changes by 4.8 degrees C during the log."


def test_spikes_are_not_a_touch() -> None:
    """Single wild samples are data errors, which the fit replaces and counts."""
    gyro, accel = still(N, 1)
    gyro[0, 5000] += 1.0
    accel[1, 7000:7002] += 5.0
    assert found(gyro, accel) == ()


@pytest.mark.parametrize(("start", "code"), [(2.0, "motion"), (90.0, "touch")])
@pytest.mark.parametrize(("factor", "level"), [(5.0, "warning"), (20.0, "error")])
def test_a_disturbance_above_the_total_noise_is_an_error(
    start: float, code: str, factor: float, level: str
) -> None:
    """2 s of 5 times the noise have the power of 48 s of noise, of 20 times 800 s; the log has 200 s."""
    gyro, accel = still(N, 4)
    shaken = (start <= T) & (start + 2 > T)
    gyro[:, shaken] += (gyro[:, shaken] - gyro[:, shaken].mean(axis=1, keepdims=True)) * (factor - 1)
    finding = one(at_rest(gyro, accel))
    assert (finding.code, finding.level) == (code, level)


@pytest.mark.parametrize(("rate", "level"), [(0.005, "warning"), (0.5, "error")])
def test_a_smooth_turn_is_judged_by_its_mean(rate: float, level: str) -> None:
    """A constant rotation has no variance in a window; the noise is 0.0015 rad/s."""
    gyro, accel = still(N, 4)
    gyro[0, 500:800] += rate
    assert [f.level for f in found(gyro, accel) if f.code == "motion"] == [level]


@pytest.mark.parametrize(("rate_hz", "word"), [(0.2, "slow"), (2e5, "fast")])
def test_an_impossible_rate_is_an_error(rate_hz: float, word: str) -> None:
    """Stamps in ms were read as s, or vice versa; both sensors share one finding."""
    found_here = screen(recording(*still(4000, 1), clock=Clock.even(4000, rate_hz)))
    (finding,) = (f for f in found_here if f.code == "absurd-rate")
    assert finding.text == f"The samples come at {rate_hz:.4g} Hz: no IMU is that {word}."
    assert (finding.level, finding.axis) == ("error", None)


@pytest.mark.parametrize("rate_hz", [50e3, 100e3, 150e3])
def test_a_rate_of_bench_instruments_is_a_warning(rate_hz: float) -> None:
    """It may be a fibre-optic gyroscope, or a MEMS sensor with another time unit."""
    found_here = screen(recording(*still(4000, 1), clock=Clock.even(4000, rate_hz)))
    (finding,) = (f for f in found_here if f.code.endswith("-rate"))
    assert (finding.level, finding.code, finding.axis) == ("warning", "fast-rate", None)
    assert finding.text == f"The samples come at {rate_hz:.4g} Hz: no MEMS sensor is that fast."
    assert grade_of(finding) == "check"


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 32e3, 40e3])
def test_usual_rates_have_no_finding(rate_hz: float) -> None:
    """They range from averages of a second to the fastest MEMS sensor."""
    codes = {f.code for f in screen(recording(*still(4000, 1), clock=Clock.even(4000, rate_hz)))}
    assert not codes & {"absurd-rate", "fast-rate"}


def test_worst_findings_come_first() -> None:
    """The order is errors, warnings, information."""
    gyro, accel = humming(*still(N, 1))
    accel[0] = 0
    levels = [f.level for f in screen(recording(gyro, accel))]
    assert levels == sorted(levels, key=["error", "warning", "info"].index)
    assert levels[0] == "error"


def test_a_log_without_rest_has_no_suggestion() -> None:
    """With a knock every few seconds there is an error and no part to keep."""
    gyro, accel = still(N, 1)
    for start in range(100, N, 600):
        accel[:, start : start + 60] += 0.5 * np.sin(np.arange(60))
    finding = one(found(gyro, accel))
    assert (finding.level, finding.code, finding.keep_s) == ("error", "motion", None)
    assert (
        finding.text == "The IMU was not at rest: it moved 34 times, 17% of the log; it never rested for 5 s."
    )
    assert finding.advice == "Record again with the IMU on a firm, quiet surface."

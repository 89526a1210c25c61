"""Logs that give each row each status that it can have."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.health import Diagnosis, Row, Status, diagnose
from imucal.recording import Recording, Temperature
from tests.health.simulated import GRAVITY, Imu, Samples, sampled, turns_and_rests, walking

__all__ = ["Case", "cases", "clean", "diagnosis_of", "row_of"]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A log, the code of a row, and the status that the row has."""

    name: str
    code: str
    status: Status
    recording: Callable[[], Recording]
    expect: str | None = None

    @property
    def row(self) -> Row:
        return row_of(diagnosis_of(self), self.code)


def diagnosis_of(case: Case) -> Diagnosis:
    return _diagnosis(case.recording, case.expect)


@cache
def _diagnosis(recording: Callable[[], Recording], expect: str | None) -> Diagnosis:
    return diagnose(recording(), expect=expect)


def row_of(diagnosis: Diagnosis, code: str) -> Row:
    return next(row for row in diagnosis.rows if row.code == code)


@cache
def clean() -> Samples:
    """Return a log of eight turns between rests."""
    rng = np.random.default_rng(11)
    return sampled(turns_and_rests(rng, turns=8, lever_m=0.02, carried_m=0.0), rng)


@cache
def walk() -> Samples:
    """Return a log without rests and turns."""
    rng = np.random.default_rng(3)
    return sampled(walking(rng, duration_s=20.0), rng)


@cache
def delayed(delay_s: float) -> Samples:
    rng = np.random.default_rng(6)
    return sampled(turns_and_rests(rng, lever_m=0.0, carried_m=0.0), rng, delay_s=delay_s)


@cache
def humming(size: float) -> Samples:
    rng = np.random.default_rng(8)
    motion = turns_and_rests(rng, turns=2, rest_s=(20.0, 25.0))
    return sampled(motion, rng, Imu(rate_hz=400.0), vibration=(size, 20 * size))


def fastest() -> int:
    """Return the sample of the clean log at which the gyroscope's y axis changes most."""
    return int(np.abs(np.diff(clean().gyroscope[:, 1])).argmax())


def gyroscope(change: Callable[[FloatArray], FloatArray]) -> Callable[[], Recording]:
    return lambda: replace(clean(), gyroscope=change(clean().gyroscope)).recording()


def accelerometer(change: Callable[[FloatArray], FloatArray]) -> Callable[[], Recording]:
    return lambda: replace(clean(), accelerometer=change(clean().accelerometer)).recording()


def stuck(x: FloatArray) -> FloatArray:
    """Return the y axis with one value for 2 s."""
    x, place = x.copy(), fastest()
    x[place - 200 : place + 200, 1] = x[place, 1]
    return x


def spiked(x: FloatArray, step: int = 900) -> FloatArray:
    x = x.copy()
    x[100::step, 0] += 3
    return x


def interpolated(x: FloatArray) -> FloatArray:
    x = x.copy()
    x[2:-1:4] = (x[1:-2:4] + x[3::4][: len(x[1:-2:4])]) / 2
    return x


def held(x: FloatArray) -> FloatArray:
    return np.repeat(x[::2], 2, axis=0)[: len(x)]


def without_numbers(x: FloatArray) -> FloatArray:
    """Return the y axis with 100 samples that are NaN."""
    x = x.copy()
    x[700:800, 1] = np.nan
    return x


def without_gravity(x: FloatArray) -> FloatArray:
    return np.asarray(x * (1 - GRAVITY / np.linalg.norm(x, axis=1, keepdims=True)))


def warming(span: float) -> Recording:
    recording = clean().recording()
    clock = recording.series[0].clock
    return replace(
        recording, temperature=Temperature(samples=np.linspace(30, 30 + span, clock.n), clock=clock)
    )


def losing(first: int, stop: int) -> Recording:
    """Return the clean log without some samples."""
    recording = clean().recording()
    keep = np.ones(recording.series[0].n, dtype=np.bool_)
    keep[first:stop] = False
    return replace(recording, series=tuple(series.keeping(keep) for series in recording.series))


def jittering(periods: float) -> Recording:
    recording = clean().recording()
    clock = recording.series[0].clock
    late = replace(clock, jitter_s=periods * clock.tau0, start_ns=10**18)
    return replace(recording, series=tuple(replace(series, clock=late) for series in recording.series))


def finding(code: str, text: str, level: str = "warning") -> Callable[[], Recording]:
    note = Finding(level, code, text)  # type: ignore[arg-type]
    return lambda: replace(clean().recording(), findings=(note,))


def dead_z(x: FloatArray) -> FloatArray:
    return np.asarray(x * [1, 1, 0])


def cases() -> Iterator[Case]:
    """Yield the cases, by row."""
    whole, moving = clean().recording, walk().recording

    def short() -> Recording:
        return whole().between(0, 0.5)

    def case(name: str, code: str, status: Status, recording: Callable[[], Recording]) -> Case:
        return Case(name=name, code=code, status=status, recording=recording)

    yield case("clean", "rate", "pass", whole)
    yield case("jitter", "rate", "warn", lambda: jittering(0.4))
    yield case("clean", "gaps", "pass", whole)
    yield case("3 lost", "gaps", "warn", lambda: losing(1000, 1003))
    yield case("100 lost", "gaps", "fail", lambda: losing(1000, 1100))
    yield case("stamped", "stamps", "pass", lambda: jittering(0.0))
    yield case("no stamps", "stamps", "unknown", whole)
    yield case("bursts", "stamps", "warn", finding("bursts", "Samples arrive in bursts of about 5.", "info"))
    yield case("jump", "stamps", "fail", finding("clock-jump", "The clock was set once."))
    yield case(
        "delay", "clocks-differ", "pass", finding("delay", "Messages were recorded 3 ms late.", "info")
    )
    yield case("drift", "clocks-differ", "warn", finding("clocks-differ", "The clocks differ by +0.2%."))
    yield case("one time", "clocks-differ", "unknown", whole)
    yield case("clean", "accelerometer-unit", "pass", whole)
    yield case("g", "accelerometer-unit", "fail", accelerometer(lambda x: x / GRAVITY))
    yield case("mg", "accelerometer-unit", "fail", accelerometer(lambda x: x / GRAVITY * 1e3))
    yield case("half", "accelerometer-unit", "fail", accelerometer(lambda x: x / 2))
    yield case(
        "swapped",
        "accelerometer-unit",
        "fail",
        lambda: replace(
            clean(), gyroscope=clean().accelerometer, accelerometer=clean().gyroscope
        ).recording(),
    )
    yield case("no gravity", "accelerometer-unit", "unknown", accelerometer(without_gravity))
    yield case("clean", "gyroscope-unit", "pass", whole)
    yield case("walk", "gyroscope-unit", "pass", moving)
    yield case("deg/s", "gyroscope-unit", "fail", gyroscope(np.degrees))
    yield case("half", "gyroscope-unit", "fail", gyroscope(lambda x: x / 2))
    yield case("13 %", "gyroscope-unit", "warn", gyroscope(lambda x: x / 1.14))
    yield case(
        "walk in deg/s",
        "gyroscope-unit",
        "fail",
        lambda: replace(walk(), gyroscope=np.degrees(walk().gyroscope)).recording(),
    )
    yield case(
        "walk, no steps",
        "gyroscope-unit",
        "unknown",
        lambda: replace(walk(), gyroscope=walk().gyroscope + 1e-4 * np.sin(walk().accelerometer)).recording(),
    )
    yield case("clean", "no-gravity", "pass", whole)
    yield case("removed", "no-gravity", "fail", accelerometer(without_gravity))
    yield case("half", "no-gravity", "unknown", accelerometer(lambda x: x / 2))
    for direction, status in (("z-up", "pass"), ("x-down", "fail"), ("z-down", "fail"), (None, "unknown")):
        yield Case(name=str(direction), code="up", status=status, recording=whole, expect=direction)  # type: ignore[arg-type]
    yield case("clean", "axes", "pass", whole)
    yield case("walk", "axes", "unknown", moving)
    yield case("z flipped", "axes", "fail", gyroscope(lambda x: x * [1, 1, -1]))
    yield case("cycled", "axes", "fail", gyroscope(lambda x: x[:, [1, 2, 0]]))
    yield case("flipped", "axes", "fail", gyroscope(lambda x: -x))
    yield case(
        "one turn, flipped",
        "axes",
        "fail",
        lambda: replace(clean(), gyroscope=-clean().gyroscope).recording().between(0, 6.0),
    )
    yield case("clean", "sensor-delay", "pass", whole)
    yield case("walk", "sensor-delay", "unknown", moving)
    yield case("6 ms", "sensor-delay", "warn", delayed(0.006).recording)
    yield case("-30 ms", "sensor-delay", "fail", delayed(-0.03).recording)
    yield case("clean", "saturated", "pass", whole)
    yield case("clipped", "saturated", "fail", gyroscope(lambda x: np.clip(x, -1, 1)))
    yield case("no axis", "saturated", "unknown", lambda: replace(whole(), series=()))
    yield case("clean", "axis-missing", "pass", whole)
    yield case("z is 0", "axis-missing", "fail", gyroscope(dead_z))
    yield case("no z", "axis-missing", "fail", lambda: replace(whole(), series=whole().series[:-1]))
    yield case("clean", "not-finite", "pass", whole)
    yield case("NaN", "not-finite", "warn", gyroscope(without_numbers))
    yield case("clean", "stuck", "pass", whole)
    yield case("2 s", "stuck", "fail", gyroscope(stuck))
    yield case("short", "stuck", "unknown", short)
    yield case("clean", "held-samples", "pass", whole)
    yield case("every second", "held-samples", "fail", gyroscope(held))
    yield case("clean", "interpolated-samples", "pass", whole)
    yield case("every fourth", "interpolated-samples", "fail", gyroscope(interpolated))
    yield case("clean", "spikes", "pass", whole)
    yield case("some", "spikes", "warn", gyroscope(spiked))
    yield case("many", "spikes", "fail", gyroscope(lambda x: spiked(x, 90)))
    yield case("clean", "duplicate-axes", "pass", whole)
    yield case("y is x", "duplicate-axes", "fail", gyroscope(lambda x: x[:, [0, 0, 2]]))
    yield case("quiet", "tone", "pass", humming(0.0).recording)
    yield case("quiet", "roll-off", "pass", humming(0.0).recording)
    yield case("propeller", "tone", "warn", humming(3e-3).recording)
    yield case("walk", "tone", "unknown", moving)
    yield case("walk", "roll-off", "unknown", moving)
    yield case("2 K", "temperature", "pass", lambda: warming(2.0))
    yield case("20 K", "temperature", "warn", lambda: warming(20.0))
    yield case("none", "temperature", "unknown", whole)

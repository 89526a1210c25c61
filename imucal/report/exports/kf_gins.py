"""KF-GINS: the ``imunoise`` block, in data-sheet units.

The biases are first-order Gauss-Markov processes given by their steady state; one correlation time
serves both sensors. It is the longest of any axis, which carries the slow power. An axis with a
shorter one gets the better of two covers, neither ever below what was measured: it keeps the noise
that drives it (too much at long times, in the end by the ratio of the times); or, where it is much
faster, it is white noise to the filter, ``2 sigma² T`` on top of N², and the walk takes its place.
"""

import math
from typing import NamedTuple

from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers, SlowNoise
from imucal.report.exports.target import Body, Target, comment, real, vector
from imucal.report.result import AxisReport

#: m/s^2 in a mGal.
_MGAL = 1e-5
_HOUR = 3600.0
#: Times closer than this are one.
_SAME = 1.001
#: Sensor -> keys of white noise and of the bias's steady state, with their factors and units.
_KEYS = {
    Sensor.GYROSCOPE: (
        ("arw", TERMS["N"].datasheet_unit(Sensor.GYROSCOPE).factor, "deg/sqrt(h)"),
        ("gbstd", TERMS["B"].datasheet_unit(Sensor.GYROSCOPE).factor, "deg/h"),
    ),
    Sensor.ACCELEROMETER: (
        ("vrw", TERMS["N"].datasheet_unit(Sensor.ACCELEROMETER).factor, "m/s/sqrt(h)"),
        ("abstd", 1 / _MGAL, "mGal"),
    ),
}


class Cover(NamedTuple):
    """White noise and steady state of an axis at the common T, the numbers used, and what to say of them."""

    white: float
    sigma: float
    used: tuple[Number, ...]
    notes: tuple[str, ...]


def cover(numbers: Numbers, axis: AxisReport, slow: SlowNoise, time: float) -> Cover:
    """Return what stands for an axis's noise, whose slow part has a T of its own, at the common T.

    Its psd is nowhere below that of the axis's N and slow process.
    """
    white = numbers.of(axis, "N")
    said = [white.note, slow.note]
    ratio, total = time / slow.correlation_time, white.value
    # 2 sigma^2 T is driving^2 T^2.
    folded = math.hypot(white.value, slow.driving * slow.correlation_time)
    if ratio > _SAME and folded < ratio * white.value:
        slow, total = numbers.walk(axis), folded
        said[-1] += f": white noise at this corrtime, which makes N {folded / white.value:.3g} x larger"
        said.append(slow.note)
    elif ratio > _SAME:
        said[-1] += f"; at the common corrtime never too small, but up to {ratio:.3g} x too large"
    used = (white,) if slow.number is None else (white, slow.number)
    return Cover(total, slow.driving * math.sqrt(time / 2), used, tuple(said))


def _body(numbers: Numbers) -> Body:
    axes = [axis for sensor in numbers.sensors for axis in numbers.triad(sensor)]
    slow = [numbers.slow(axis) for axis in axes]
    time = max(process.correlation_time for process in slow)
    covers = [cover(numbers, axis, process, time) for axis, process in zip(axes, slow, strict=True)]
    lines = [*comment(note for each in covers for note in each.notes), "imunoise:"]
    for i, sensor in enumerate(numbers.sensors):
        (white, to_white, white_unit), (bias, to_bias, bias_unit) = _KEYS[sensor]
        three = covers[3 * i : 3 * i + 3]
        lines.append(f"  {white}: {vector(each.white * to_white for each in three)}  # {white_unit}")
        lines.append(f"  {bias}: {vector(each.sigma * to_bias for each in three)}  # {bias_unit}")
    lines += [
        "  # gsstd, asstd: scale factors aren't measured at rest; keep the lines of your own file",
        f"  corrtime: {real(time / _HOUR)}  # h",
    ]
    return [number for each in covers for number in each.used], lines


TARGETS = (
    Target(
        name="kf-gins",
        title="KF-GINS imunoise block",
        file_name="kf_gins_imunoise.yaml",
        heading="KF-GINS imunoise",
        source="source: dataset/kf-gins.yaml, src/kf-gins/gi_engine.cpp",
        kind="continuous-time, in data-sheet units; biases are first-order Gauss-Markov processes",
        formulas=(
            "arw, vrw = N; with a Gauss-Markov term much faster than corrtime: sqrt(N^2 + 2 sigma^2 T)",
            "gbstd, abstd = sigma of the Gauss-Markov term; of a random walk K: K * sqrt(corrtime / 2)",
            "corrtime = the longest T of all axes (one serves both sensors); 1 h where none was measured",
        ),
        body=_body,
        notes=("the order of the axes is the log's; KF-GINS wants forward, right, down",),
        carries="N K GM",
        per_axis=True,
    ),
)

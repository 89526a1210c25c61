"""KF-GINS: the ``imunoise`` block, in data-sheet units.

The biases are first-order Gauss-Markov processes given by their steady state; one correlation time
serves all axes of both sensors: of those that were measured, and one long against the horizon, the one
that costs least.
"""

from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Body, Target, comment, real, vector

#: m/s^2 in a mGal.
_MGAL = 1e-5
_HOUR = 3600.0
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


def _body(numbers: Numbers) -> Body:
    axes = numbers.with_bias([axis for sensor in numbers.sensors for axis in numbers.triad(sensor)])
    lines = [*comment(axis.note for axis in axes), "imunoise:"]
    for i, sensor in enumerate(numbers.sensors):
        (white, to_white, white_unit), (bias, to_bias, bias_unit) = _KEYS[sensor]
        three = axes[3 * i : 3 * i + 3]
        lines.append(f"  {white}: {vector(each.white * to_white for each in three)}  # {white_unit}")
        lines.append(f"  {bias}: {vector(each.sigma * to_bias for each in three)}  # {bias_unit}")
    lines += [
        "  # gsstd, asstd: scale factors aren't measured at rest; keep the lines of your own file",
        f"  corrtime: {real(axes[0].correlation_time / _HOUR)}  # h",
    ]
    return [number for axis in axes for number in axis.used], lines


TARGETS = (
    Target(
        name="kf-gins",
        title="KF-GINS imunoise block",
        file_name="kf_gins_imunoise.yaml",
        heading="KF-GINS imunoise",
        source="source: dataset/kf-gins.yaml, src/kf-gins/gi_engine.cpp",
        kind="continuous-time, in data-sheet units; biases are first-order Gauss-Markov processes",
        formulas=(
            "arw, vrw = N; gbstd, abstd = sigma of the bias, K * sqrt(corrtime / 2) where it walks",
            "corrtime = T of the bias (one serves both sensors), long where none that was measured is better",
        ),
        body=_body,
        notes=("the order of the axes is the log's; KF-GINS wants forward, right, down",),
        carries="N K GM",
        per_axis=True,
    ),
)

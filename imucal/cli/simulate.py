"""``imucal simulate``: write a log with known noise."""

import math
from pathlib import Path

import click

from imucal.cli._printing import echo, picked, print_json, print_note
from imucal.cli.context import misuse
from imucal.cli.options import OUTPUT, Command, flag, option, out_option, quiet, unwrapped
from imucal.cli.param_types import DURATION, RATE, Number, Text, model_of
from imucal.noise import NoiseModel
from imucal.recording import Sensor
from imucal.units import G0
from imucal.user_input import seconds_of

#: Six axes take 48 GB.
_MAX_SAMPLES = 1e9


def _gap(text: str) -> tuple[float, float]:
    """Return start and length in s of ``START:LENGTH``."""
    start, colon, length = text.partition(":")
    if not colon:
        raise ValueError(f"{text!r} is not START:LENGTH, such as 60s:2s")
    return seconds_of(start), seconds_of(length)


def log_to_write(_: click.Context, __: click.Parameter, path: Path | None) -> Path | None:
    """Return the path of a log, or None; a usage error if no format has its suffix."""
    from imucal.simulation import WRITERS

    if path is not None and path.suffix.lower() not in WRITERS:
        known = ", ".join(suffix or "none (a ROS 2 folder)" for suffix in WRITERS)
        raise click.BadParameter(f"{path.name!r} ends in {path.suffix!r}; expected one of {known}")
    return path


def _ramp(text: str) -> tuple[float, float]:
    """Return the lowest and the highest temperature of ``LOW:HIGH``, in degrees Celsius."""
    low, _, high = text.partition(":")
    try:
        ends = float(low), float(high)
    except ValueError:
        ends = math.nan, math.nan
    if not all(map(math.isfinite, ends)):
        raise ValueError(f"{text!r} is not LOW:HIGH in degrees Celsius, such as -10:60")
    return ends


_EPILOG = unwrapped(r"""
Examples:
  imucal simulate "N=1e-4 + B=2e-5 + K=1e-6" -o still.mcap
  imucal simulate "N=0.3deg/sqrt(h) + B=5deg/h" --accel "N=60ug/sqrt(Hz)" \
    --rate 400 --duration 2h --gap 10min:3s -o gaps.bag
  imucal simulate "N=1e-4" --accel "N=1e-3" --rests 18 --json -o poses.mcap
  imucal simulate "N=1e-4" --temperature=-10:60 --duration 1h --rate 20 \
    -o ramp.csv
""")


@click.command(cls=Command, epilog=_EPILOG)
@click.argument("model", type=model_of(Sensor.GYROSCOPE))
@option("--accel", metavar="MODEL", help="Model of the accelerometer. [default: the numbers of MODEL]")
@option("--rate", metavar="HZ", type=RATE, default=200.0, show_default=True, help="Sampling rate in Hz.")
@option(
    "--duration", metavar="TIME", type=DURATION, default="10min", show_default=True, help="Length of the log."
)
@option(
    "--gap",
    "gaps",
    metavar="START:LENGTH",
    type=Text("gap", _gap),
    multiple=True,
    help="Omit these samples; may be repeated.",
)
@option(
    "--gyro-lsb", metavar="X", type=Number(min=0), default=0.0, help="Resolution of the gyroscope, in rad/s."
)
@option(
    "--accel-lsb",
    metavar="X",
    type=Number(min=0),
    default=0.0,
    help="Resolution of the accelerometer, in m/s^2.",
)
@option(
    "--rests",
    metavar="N",
    type=click.IntRange(6, 1000),
    help="Simulate N rests and the turns between them, for imucal calibrate.",
)
@option(
    "--rest",
    metavar="TIME",
    type=DURATION,
    default="5s",
    show_default=True,
    help="Length of each rest, with --rests.",
)
@option(
    "--temperature",
    "ramp",
    metavar="LOW:HIGH",
    type=Text("ramp", _ramp),
    help="Simulate heating and cooling between two temperatures, in degrees Celsius, for imucal thermal. "
    "The log must be a .csv.",
)
@option(
    "--seed",
    metavar="N",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the random numbers.",
)
@out_option(
    "FILE",
    callback=log_to_write,
    required=True,
    help="Write the log to FILE: .csv, .mcap, .bag, .db3, or a folder (ROS 2).",
)
@flag("--json", "as_json", group=OUTPUT, help="Print the true values as JSON on standard output.")
@quiet
def command(
    *,
    model: str,
    accel: str | None,
    out: Path,
    rate: float,
    duration: float,
    gaps: tuple[tuple[float, float], ...],
    gyro_lsb: float,
    accel_lsb: float,
    rests: int | None,
    rest: float,
    ramp: tuple[float, float] | None,
    seed: int,
    as_json: bool,
) -> None:
    """Write a log of an IMU at rest with known noise.

    MODEL is a sum of terms with continuous coefficients, the same for the three gyroscope axes:
    N=… (rad/s/√Hz), B=… (rad/s), K=… (rad/s/√s), Q=… (rad), R=… (rad/s²), GM(sigma=…, T=…) (rad/s, s);
    m/s² in place of rad/s for the accelerometer. A number may have another unit, such as
    N=0.3deg/sqrt(h), or N=60ug/sqrt(Hz) for the accelerometer.
    """
    from imucal.calibration.known_log import simulate_rests
    from imucal.simulation import SensorTruth, simulate_recording, write_log
    from imucal.temperature.known_log import simulate_ramp

    length = duration if rests is None else rests * (rest + 2.0)
    if not 1 <= length * rate <= _MAX_SAMPLES:
        misuse(
            f"{length:g} s at {rate:g} Hz give {length * rate:.3g} samples; expected 1 to {_MAX_SAMPLES:g}"
        )
    _refuse_together(gaps=gaps, rests=rests, ramp=ramp, out=out)
    try:
        models = NoiseModel.parse(model), NoiseModel.parse(accel or model, Sensor.ACCELEROMETER)
    except ValueError as error:
        misuse(error, "--accel")
    errors: dict[str, object] = {}
    try:
        if rests:
            lsb = gyro_lsb, accel_lsb
            recording, known = simulate_rests(models, rests, rest_s=rest, rate_hz=rate, seed=seed, lsb=lsb)
            errors = {"calibration": picked(known, "M_a b_a M_g b_g G")}
        elif ramp:
            recording, effect = simulate_ramp(
                models,
                low_c=ramp[0],
                high_c=ramp[1],
                rate_hz=rate,
                duration_s=duration,
                seed=seed,
                lsb=(gyro_lsb, accel_lsb),
            )
            errors = {"thermal": picked(effect, "middle_c half_k lag_s gyroscope accelerometer")}
        else:
            recording = simulate_recording(
                gyroscope=SensorTruth(model=models[0], mean=(0.0, 0.0, 0.0), lsb=gyro_lsb),
                accelerometer=SensorTruth(model=models[1], mean=(0.0, 0.0, G0), lsb=accel_lsb),
                rate_hz=rate,
                duration_s=duration,
                seed=seed,
                gaps_s=gaps,
            )
    except ValueError as error:
        misuse(error)
    write_log(recording, out)
    if not as_json:
        echo(str(out))
        return
    clock = recording.series[0].clock
    truth = {
        "gyroscope": {"model": models[0].text(), "lsb": gyro_lsb},
        "accelerometer": {"model": models[1].text(), "lsb": accel_lsb},
        "rate_hz": rate,
        "samples": clock.n,
        "duration_s": clock.duration_s,
        "gaps": [picked(gap, "start_s duration_s") for gap in clock.gaps],
        "seed": seed,
        **errors,
    }
    print_json(truth)
    print_note(f"{clock.n} samples at {rate:g} Hz, {clock.duration_s:g} s, written to {out}")


def _refuse_together(
    *,
    gaps: tuple[tuple[float, float], ...],
    rests: int | None,
    ramp: tuple[float, float] | None,
    out: Path,
) -> None:
    """Refuse options that exclude each other, and a ramp in a format without a temperature."""
    if rests and gaps:
        misuse("--gap and --rests exclude each other; omit one")
    if ramp and (gaps or rests):
        misuse("--temperature excludes --gap and --rests; omit them")
    if ramp and out.suffix.lower() != ".csv":
        misuse(f"{out.name} has no place for a temperature; name a .csv file", "-o")

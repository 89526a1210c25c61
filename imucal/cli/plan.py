"""``imucal plan``: how long to record for a precision, attitudes of a calibration, speed of a ramp."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import click

from imucal.calibration.known_log import RestsPlan, plan_rests
from imucal.calibration.noise_source import report_models
from imucal.calibration.parameters import Parameter
from imucal.calibration.table import readable
from imucal.cli._printing import FULL, can_print, echo, picked, print_json, print_note, width, wrapped
from imucal.cli._report_input import report_or_model
from imucal.cli.context import misuse
from imucal.cli.options import (
    MODEL,
    OUTPUT,
    Command,
    flag,
    model_options,
    option,
    quiet,
    si_units,
    unwrapped,
)
from imucal.cli.param_types import DURATION, LEVEL, PRECISION, RATE, Number, Text
from imucal.noise.terms import TERMS
from imucal.planning import ENOUGH_DETECTED, ONE_DEVIATION, Need, Plan, needed_time, plan
from imucal.recording import Sensor
from imucal.report.result import Report
from imucal.temperature.document import load_thermal
from imucal.temperature.planning import RampNeed, plan_ramp
from imucal.temperature.table import UNITS
from imucal.temperature.writer import is_thermal
from imucal.units import SAMPLE_UNITS, DatasheetUnit
from imucal.units import duration as duration_text
from imucal.user_input import quantity

SCHEMA = "imucal/planning/1"
REST_SCHEMA = "imucal/calibration-plan/1"
RAMP_SCHEMA = "imucal/thermal-plan/1"
_KINDS = {"scale": "scale", "misalignment": "misalignment", "bias": "bias", "g_sensitivity": "g-sensitivity"}


def _error_of(sensor: Sensor) -> Text:
    """Return the type of an option for an error of a sensor, such as ``5deg/h``; the value is in SI."""

    def parse(text: str) -> float:
        value = quantity(text, SAMPLE_UNITS[sensor])
        if value is None or not value > 0:
            units = ", ".join(SAMPLE_UNITS[sensor])
            raise ValueError(f"{text!r} is not a positive number with one of the units {units}")
        return value

    return Text("error", parse)


_EPILOG = unwrapped("""
Examples:
  imucal plan "N=0.3deg/sqrt(h) + B=5deg/h" --rate 200
  imucal plan --accel "N=60ug/sqrt(Hz)" --rate 200
  imucal plan log-imucal --precision 5% --level 0.95
  imucal plan log-imucal --duration 3h --json -q
  imucal plan log-imucal --rests 18 --rest 5s --latitude 47.4
  imucal plan ramp-thermal --gyro-error 5deg/h --accel-error 0.5mg

Exit codes: 0 done, 2 usage, 3 the report can't be read.
""")


@click.command(cls=Command, epilog=_EPILOG)
@click.argument("source", metavar="MODEL_OR_REPORT", required=False)
@model_options
@option("--rate", metavar="HZ", type=RATE, help="Sampling rate in Hz; required with a model.")
@option(
    "--precision",
    metavar="FRACTION",
    type=PRECISION,
    default="10%",
    show_default=True,
    help="Relative half-width of each term's interval.",
)
@option(
    "--duration",
    metavar="TIME",
    type=DURATION,
    help="Also predict the precision of a log of this length, such as 3h.",
)
@option(
    "--rests", metavar="N", type=click.IntRange(6, 1000), help="Plan a log of N rests for imucal calibrate."
)
@option(
    "--rest",
    metavar="TIME",
    type=DURATION,
    default="5s",
    show_default=True,
    help="Length of each rest, with --rests.",
)
@option("--latitude", metavar="DEG", type=Number(-90, 90), help="Latitude of the place, with --rests.")
@option(
    "--gyro-error",
    metavar="RATE",
    type=_error_of(Sensor.GYROSCOPE),
    help="Error that a ramp for imucal thermal may leave, such as 5deg/h.",
)
@option(
    "--accel-error",
    metavar="FORCE",
    type=_error_of(Sensor.ACCELEROMETER),
    help="The same for the accelerometer, such as 0.5mg.",
)
@flag("--json", "as_json", group=OUTPUT, help="Print the plan as JSON (SI) on standard output.")
@si_units
@quiet
@option(
    "--level",
    group=MODEL,
    metavar="P",
    type=LEVEL,
    help="Confidence level of every interval. [default: 0.683, one standard deviation]",
)
def command(
    *,
    source: str | None,
    models: dict[Sensor, str],
    rate: float | None,
    precision: float,
    level: float | None,
    duration: float | None,
    rests: int | None,
    rest: float,
    latitude: float | None,
    gyro_error: float | None,
    accel_error: float | None,
    si: bool,
    as_json: bool,
) -> None:
    """Compute how long to record for a given precision of each noise term.

    MODEL_OR_REPORT is a model of the gyroscope, such as "N=0.3deg/sqrt(h) + B=5deg/h" (numbers without
    a unit are SI), or a report.json or its folder. Times follow from the smallest error that any method
    can reach (the Cramér-Rao bound). They are long enough that about four of five logs detect the term.
    If a report contains only an upper bound of a term, the bound is used. For the folder of imucal
    thermal, the plan is how slowly to heat and cool so that a curve without a lag has the given error.
    """
    if _plans_a_ramp(source, gyro_error, accel_error, as_json=as_json):
        return
    report = report_or_model(source, models, rate)
    if rests:
        _plan_rests(report, rests, rest, latitude, as_json=as_json)
        return
    result = plan(
        report,
        rate_hz=rate,
        precision=precision,
        level=level or ONE_DEVIATION,
        duration_s=duration,
    )
    if as_json:
        print_json(to_document(result))
    else:
        echo(_table(result, datasheet=not si))
    if any(need.bounded for axis in result.axes for need in axis.needs):
        print_note("< value: not detected; the time is for a term as large as this bound")
    if not as_json and any(_may_be_missed(need) for axis in result.axes for need in axis.needs):
        print_note("(n of 10): chance that a log this long detects the term")


def to_document(result: Plan) -> dict[str, object]:
    """Return a plan as JSON values, SI; null where no record is long enough."""
    return {
        "schema": SCHEMA,
        **picked(result, "precision level needed_s"),
        "axes": [
            {
                "axis": axis.axis or None,
                **picked(axis, "model rate_hz duration_s"),
                "terms": [
                    picked(need, "name value bounded needed_s reached detected") for need in axis.needs
                ],
            }
            for axis in result.axes
        ],
    }


def _table(result: Plan, *, datasheet: bool) -> str:
    percent = f"{100 * result.precision:.3g} %"
    spread = "1 sd" if result.level == ONE_DEVIATION else f"{100 * result.level:.4g} %"
    durations = {axis.duration_s for axis in result.axes}
    lines = wrapped(f"Record length for ±{percent} ({spread}) of each term")
    narrow = width() < FULL
    for axis in result.axes:
        title = f"{axis.axis or axis.model}  at {axis.rate_hz:.6g} Hz"
        if axis.duration_s is not None:
            title += f", {duration_text(axis.duration_s)}"
        lines += ["", *wrapped(title)]
        if not narrow:
            reached = "" if durations == {None} else f"{'this gives':>17}"
            lines.append(f"  {'term':<10}{'value':>12}  {'unit':<18}{'needs':>19}{reached}")
        for need in axis.needs:
            lines += _lines(need, _unit(axis.sensor, need, datasheet=datasheet), narrow=narrow)
    text = "\n".join(lines)
    return text if can_print(text) else text.replace("±", "+-")


def _lines(need: Need, unit: DatasheetUnit, *, narrow: bool) -> list[str]:
    """Return a required duration as a row, or as two lines on a narrow terminal."""
    value = f"{'< ' if need.bounded else ''}{need.value * unit.factor:.4g}"
    time = needed_time(need.needed_s)
    reached = _reached(need)
    if narrow:
        needs = f"needs {time}{f', this gives {reached}' if reached else ''}"
        return [f"  {need.name:<10}{value} {unit.name}", *wrapped(needs, indent=4)]
    return [f"  {need.name:<10}{value:>12}  {unit.name:<18}{time:>19}{f'{reached:>17}' if reached else ''}"]


def _reached(need: Need) -> str:
    """Return the precision that a log of the given length reaches, and how often it detects the term."""
    if need.reached is None:
        return ""
    if need.reached >= 1:
        return "nothing"
    often = f" ({math.floor(10 * (need.detected or 0.0))} of 10)" if _may_be_missed(need) else ""
    return f"±{100 * need.reached:.2g} %{often}"


def _may_be_missed(need: Need) -> bool:
    return need.detected is not None and need.detected < ENOUGH_DETECTED


def _unit(sensor: Sensor | None, need: Need, *, datasheet: bool) -> DatasheetUnit:
    if need.name.endswith(".T") or sensor is None:
        return DatasheetUnit("s" if need.name.endswith(".T") else "SI", 1.0)
    term = TERMS[need.symbol]
    return term.datasheet_unit(sensor) if datasheet else DatasheetUnit(term.unit(sensor), 1.0)


def _plan_rests(report: Report, rests: int, rest_s: float, latitude: float | None, *, as_json: bool) -> None:
    rate = report.axes[0].rate_hz
    found = plan_rests(report_models(report), rests, rest_s=rest_s, rate_hz=rate, latitude=latitude)
    if as_json:
        print_json(_rests_document(found))
        return
    text = "\n".join(_rests_lines(found, latitude))
    echo(text if can_print(text) else text.replace("±", "+-").replace("²", "^2").replace("°", " deg"))


def _rests_document(found: RestsPlan) -> dict[str, object]:
    sensors = {"accelerometer": found.accelerometer, "gyroscope": found.gyroscope}
    return {
        "schema": REST_SCHEMA,
        **picked(found, "rest_s rate_hz duration_s attitudes"),
        "half_widths": {
            sensor: {name: picked(each, "half_width unit status") for name, each in parameters.items()}
            for sensor, parameters in sensors.items()
        },
    }


def _rests_lines(found: RestsPlan, latitude: float | None) -> Iterator[str]:
    count = len(found.attitudes)
    yield from wrapped(
        f"{count} rests of {duration_text(found.rest_s)}, {duration_text(found.duration_s)} with the turns"
    )
    yield ""
    yield from wrapped("Expected half-width of the 95 % interval of the worst axis")
    for name, parameters in (("accelerometer", found.accelerometer), ("gyroscope", found.gyroscope)):
        for kind, shown in _KINDS.items():
            if half := _worst(parameters, kind):
                yield from wrapped(f"{name:<14}{shown:<14}± {half}", indent=2)
    yield ""
    yield from wrapped("Attitudes; turning by hand is precise enough")
    for number, text in enumerate(found.attitudes, start=1):
        first, *others = wrapped(text, indent=5)
        yield from (f"{number:>3}{first[3:]}", *others)
    yield ""
    yield from wrapped("Nonlinearity and warm-up widen the intervals. Turn in different directions.")
    if latitude is None:
        yield from wrapped("Give --latitude: otherwise the uncertainty of gravity limits the scales.")


def _worst(parameters: Mapping[str, Parameter], kind: str) -> str:
    own = [each for name, each in parameters.items() if name.startswith(kind) and each.half_width is not None]
    if not own:
        return ""
    value, unit = readable(max(each.half_width or 0.0 for each in own), own[0].unit)
    return f"{value:.2g} {unit}"


def _plans_a_ramp(
    source: str | None, gyro_error: float | None, accel_error: float | None, *, as_json: bool
) -> bool:
    """Print the plan of a ramp if the source is one; refuse errors for another source."""
    wanted = {Sensor.GYROSCOPE: gyro_error, Sensor.ACCELEROMETER: accel_error}
    errors = {sensor: error for sensor, error in wanted.items() if error is not None}
    if source is not None and is_thermal(Path(source)):
        _plan_ramp(Path(source), errors, as_json=as_json)
        return True
    if errors:
        misuse("--gyro-error and --accel-error need the folder of 'imucal thermal'; omit them")
    return False


def _plan_ramp(path: Path, errors: Mapping[Sensor, float], *, as_json: bool) -> None:
    if not errors:
        misuse(f"{path} is a temperature ramp: add --gyro-error 5deg/h, --accel-error 0.5mg, or both")
    found = load_thermal(path)
    needs = plan_ramp(found, errors)
    if as_json:
        print_json(
            {
                "schema": RAMP_SCHEMA,
                "axes": [picked(need, "axis error slope lag_s speed_k_per_s duration_s") for need in needs],
            }
        )
        return
    span = f"{found.low_c:.0f} to {found.high_c:.0f} °C and back"
    text = "\n".join(
        [*wrapped(f"Speed of a ramp from {span}, for a curve without a lag"), *_ramp_lines(needs)]
    )
    echo(text if can_print(text) else text.replace("°", "deg "))


def _ramp_lines(needs: Sequence[RampNeed]) -> Iterator[str]:
    for need in needs:
        unit, factor = UNITS[need.sensor]
        error = f"{need.axis}: {need.error * factor:.3g} {unit}"
        if need.speed_k_per_s is None or need.duration_s is None:
            yield from wrapped(f"{error} at any speed: no lag was found")
            continue
        yield from wrapped(
            f"{error} at {60 * need.speed_k_per_s:.2g} K/min or less, {duration_text(need.duration_s)} "
            f"in all (it follows {need.lag_s:.0f} s later)"
        )

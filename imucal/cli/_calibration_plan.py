"""``imucal plan --rests``: attitudes of a calibration, and the precision to expect."""

from collections.abc import Iterator, Mapping

from imucal.calibration.known_log import RestsPlan, plan_rests
from imucal.calibration.noise_source import report_models
from imucal.calibration.parameters import Parameter
from imucal.calibration.table import readable
from imucal.cli._printing import can_print, echo, picked, print_json, wrapped
from imucal.report.result import Report
from imucal.units import duration

__all__ = ["plan_calibration"]

SCHEMA = "imucal/calibration-plan/1"
_KINDS = {"scale": "scale", "misalignment": "misalignment", "bias": "bias", "g_sensitivity": "g-sensitivity"}


def plan_calibration(
    report: Report, rests: int, rest_s: float, latitude: float | None, *, as_json: bool
) -> None:
    """Print the plan of a log with `rests` rests, as a table or as JSON."""
    rate = report.axes[0].rate_hz
    found = plan_rests(report_models(report), rests, rest_s=rest_s, rate_hz=rate, latitude=latitude)
    if as_json:
        print_json(to_document(found))
        return
    text = "\n".join(_lines(found, latitude))
    echo(text if can_print(text) else text.replace("±", "+-").replace("²", "^2").replace("°", " deg"))


def to_document(found: RestsPlan) -> dict[str, object]:
    """Return a plan as JSON values, SI."""
    sensors = {"accelerometer": found.accelerometer, "gyroscope": found.gyroscope}
    return {
        "schema": SCHEMA,
        **picked(found, "rest_s rate_hz duration_s attitudes"),
        "half_widths": {
            sensor: {name: picked(each, "half_width unit status") for name, each in parameters.items()}
            for sensor, parameters in sensors.items()
        },
    }


def _lines(found: RestsPlan, latitude: float | None) -> Iterator[str]:
    count = len(found.attitudes)
    yield from wrapped(
        f"{count} rests of {duration(found.rest_s)}, {duration(found.duration_s)} with the turns"
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

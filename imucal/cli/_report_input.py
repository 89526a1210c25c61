"""The REPORT argument: a report.json, its folder, a log, which is characterised first, or a model."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.calibration.writer import is_calibration
from imucal.cli._printing import as_typed, name_of_log, print_note
from imucal.cli.context import misuse
from imucal.cli.log_request import LogRequest
from imucal.errors import Fix, ReadError
from imucal.recording import Sensor
from imucal.remote import is_url
from imucal.remote.addresses import shown
from imucal.report.result import Report

if TYPE_CHECKING:
    from imucal.calibration.document import CalibrationDocument


def report_request(request: LogRequest, models: dict[Sensor, str]) -> LogRequest:
    """Return a request with the models of the options or of the argument in place of logs, if there are any.

    A usage error if neither a report, a log nor a model is named, or if they exclude each other.
    """
    given = next((log for log in request.logs if is_model(log)), None)
    if given is not None and len(request.logs) > 1:
        misuse(f"{given!r} is a model; give one model, one report, or logs only")
    if given is None and request.logs and not models:
        return request
    models = with_model(given or next(iter(request.logs), None), models)
    # Messages contain the model in place of the log's path.
    return replace(request, logs=tuple(models.values())[:1], models=models)


def is_model(text: str) -> bool:
    """Return whether a text is a model and not a path or a URL."""
    return "=" in text and not is_url(text) and not os.path.exists(text)  # noqa: PTH110 - never raises


def with_model(source: str | None, models: Mapping[Sensor, str], name: str = "REPORT") -> dict[Sensor, str]:
    """Return the models of the options and of the named argument, which is the gyroscope's.

    A usage error if there is no model, if the argument is no model, or if the gyroscope has two.
    """
    from imucal.noise.model import NoiseModel

    if source is None:
        if not models:
            raise click.MissingParameter(param_hint=f"'{name}'", param_type="argument")
        return dict(models)
    if not is_model(source):
        misuse(f"{shown(source)} is a path; give either a path or models (--gyro, --accel)")
    if Sensor.GYROSCOPE in models:
        misuse(f"{source!r} is a gyroscope model, and --gyro is another; give one")
    try:
        NoiseModel.parse(source)
    except ValueError as error:
        misuse(f"{source!r} is neither a file, a folder nor a gyroscope model: {error}")
    return {Sensor.GYROSCOPE: source, **models}


def given_report(models: Mapping[Sensor, str], rate_hz: float | None) -> Report:
    """Return models in the form of a report."""
    from imucal.report.given import model_as_report

    if rate_hz is None:
        misuse("a model has no sampling rate; give one, such as --rate 200")
    return model_as_report(models, rate_hz=rate_hz)


def part_report(name: str, request: LogRequest) -> Report:
    """Return the figures of a part's data sheet in the form of a report; a usage error without a rate."""
    from imucal.report.given import part_as_report
    from imucal.sensors import find_sensor

    part = find_sensor(name)
    _refuse_reading(
        [each for each in sorted(request.settings()) if each != "rate_hz"], f"{part.name} is a part"
    )
    rate_hz = request.reading["rate_hz"]
    if rate_hz is None:
        misuse("a data sheet has no sampling rate; give one, such as --rate 200")
    return part_as_report(part, rate_hz=rate_hz)


def report_or_model(source: str | None, models: Mapping[Sensor, str], rate_hz: float | None) -> Report:
    """Load a report by its file, folder or URL, or make one from models."""
    if source is None or models or is_model(source):
        return given_report(with_model(source, models), rate_hz)
    return read_report(source)


def load_report(request: LogRequest) -> Report:
    """Load a report, read and characterise a log, or make a report from models.

    Reading options are refused with a report, because they would have no effect.
    """
    if not request.logs:
        raise click.MissingParameter(param_hint="'REPORT'", param_type="argument")
    asked = sorted(request.settings())
    if request.models:
        _refuse_reading([name for name in asked if name != "rate_hz"], f"{request.logs[0]!r} is a model")
        return given_report(request.models, request.reading["rate_hz"])
    first = next((log for log in request.logs if is_report(log)), None)
    if first is None:
        return _characterise(request)
    if len(request.logs) > 1:
        misuse(f"{shown(first)} is a report; give one report, or logs only")
    _refuse_reading(asked, f"{shown(first)} is a report")
    return read_report(first)


def load_calibrated(request: LogRequest) -> "CalibrationDocument":
    """Load the document of a calibration; refuse options for reading a log."""
    from imucal.calibration.document import load_document

    first = request.logs[0]
    refuse_reading(request, f"{first} is a calibration")
    return load_document(Path(first))


def refuse_reading(request: LogRequest, what: str) -> None:
    """Refuse options for reading a log; `what` says why they have no effect."""
    _refuse_reading(sorted(request.settings()), what)


def _refuse_reading(asked: list[str], what: str) -> None:
    if asked:
        names = ", ".join(name.removesuffix("_s").removesuffix("_hz").replace("_", "-") for name in asked)
        misuse(f"{what}, and {names} applies to a log only; use it with 'imucal fit LOG'")


def read_report(report: str | Path) -> Report:
    """Load a report by its file, folder or URL; for a log, the error explains what to do."""
    from imucal.readers.remote_logs import local_logs
    from imucal.report.json_file import load

    if is_url(report):
        if not is_report(report):
            advice = Fix("run 'imucal fit' on it first")
            raise ReadError("not a report.json", place=shown(str(report)), fix=advice)
        with local_logs([report]) as reports:
            return load(reports.paths[0])
    path = Path(report)
    if path.is_file() and path.suffix != ".json":
        problem = "not a report.json or its folder"
        raise ReadError(problem, place=path, fix=Fix(f"run 'imucal fit {as_typed(path)}' first"))
    if path.exists() and is_calibration(path):
        advice = Fix(f"to see its values in a file, type 'imucal export {as_typed(path)} --to yaml -o -'")
        raise ReadError("a calibration, not a report of noise", place=path, fix=advice)
    return load(path)


def is_report(log: str | Path) -> bool:
    """Return whether a path or a URL is a report and not a log."""
    if is_url(log):
        return name_of_log(str(log)).endswith(".json")
    path = Path(log)
    return path.suffix == ".json" or (path / "report.json").exists()


def _characterise(request: LogRequest) -> Report:
    from imucal.cli._printing import print_findings
    from imucal.pipeline import Settings

    report = request.characterise(Settings(reading=request.settings()))
    print_findings(report.all_findings)
    print_note("Characterised with the defaults of 'imucal fit'")
    return report

"""``imucal decompose``: the bias over time in a log."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucal._version import __version__
from imucal.cli._printing import FITTING, echo, print_findings, print_json, print_note, progress, refuse
from imucal.cli.context import misuse
from imucal.cli.fit import report_folder
from imucal.cli.log_request import LogRequest
from imucal.cli.options import (
    MODEL,
    OUTPUT,
    Command,
    flag,
    force,
    log_options,
    model,
    option,
    out_option,
    pictures,
    unwrapped,
)
from imucal.cli.param_types import DURATION
from imucal.errors import DataError
from imucal.recording import AxisSeries, Recording, Sensor

if TYPE_CHECKING:
    from imucal.fitting.noise_fit import NoiseFit
    from imucal.report.out_folder import FilesOfFolder

_AXES = tuple(f"{sensor.short}_{axis}" for sensor in Sensor for axis in "xyz")


_EPILOG = unwrapped("""
Examples:
  imucal decompose log.mcap
  imucal decompose log.bag --axis gyro_z --model "N + B + K" -o bias
  imucal decompose log.csv --every 10s --npz
  imucal decompose log.mcap --json -q | jq '.axes[].components'

Exit codes: 0 done, 2 usage, 3 the log can't be read, 4 the data can't be
analysed (with --strict: or a warning was found), 5 the files can't be
written, 130 interrupted.
""")


@click.command(cls=Command, epilog=_EPILOG)
@option(
    "--axis", "axes", type=click.Choice(_AXES), multiple=True, help="Use only this axis; may be repeated."
)
@option(
    "--every",
    metavar="TIME",
    type=DURATION,
    help="Time between rows of the CSV. [default: at most 10000 rows]",
)
@force
@out_option(
    "DIR",
    help="Write the files to DIR. [default: NAME-decomposed]",
)
@flag("--json", "as_json", group=OUTPUT, help="Print decomposition.json on standard output.")
@pictures
@flag("--npz", group=OUTPUT, help="Also write NAME.npz, with a value for every sample.")
@log_options
@model
@flag("--no-clean", group=MODEL, help="Keep spikes instead of leaving them out.")
def command(
    *,
    request: LogRequest,
    out: Path | None,
    axes: tuple[str, ...],
    model: str,
    every: float | None,
    npz: bool,
    formats: tuple[str, ...],
    no_clean: bool,
    as_json: bool,
) -> None:
    """Draw the bias of every axis of LOG over time, and its parts.

    First, a noise model is fitted to each axis. Then the bias at every moment and its parts (random
    walk, flicker, Gauss-Markov, ramp) are estimated from all samples before and after, with standard
    errors. AXIS.png shows the bias and the samples. AXIS.csv contains the bias and its parts with
    standard errors (_se). decomposition.json contains the model.
    """
    from imucal.pipeline import Settings, characterize
    from imucal.report.decomposition_files import DOCUMENT, SCHEMA, out_folder
    from imucal.report.typed_json import dumps

    if every == 0:
        misuse("expected a time above 0, such as 10s", "--every")
    folder = out_folder(out or report_folder(request.logs[0], "decomposed"))
    folder.check()
    recording = _only(request.read(), axes)
    settings = Settings(model=model, clean=not no_clean, reading=request.settings())
    with progress(*FITTING) as update:
        report = characterize(recording, settings, progress=update)
    print_findings(report.all_findings)
    path = recording.source.path
    described = []
    failed = False
    asked = {"formats": formats, "every_s": every, "arrays": npz, "source": path}
    with folder.filling() as files:
        for axis in report.axes:
            series = recording.axis(axis.sensor, axis.axis)
            try:
                described.append(_decompose_axis(series, axis.fit, files, clean=not no_clean, **asked))
            except DataError as error:
                echo(f"Error: {error}", err=True)
                failed = True
        if not described:
            raise DataError("no axis can be decomposed", place=path)
        document: dict[str, object] = {
            "schema": SCHEMA,
            "version": __version__,
            "source": {"path": path, "format": recording.source.format},
            "settings": {**settings.document(), "every_s": every},
            "axes": described,
        }
        files.add(DOCUMENT, dumps(document).encode())
    if as_json:
        print_json(document, indent=1)
    else:
        echo(_table(described))
    for written in files.paths:
        print_note(written)
    findings = report.all_findings
    refuse(report.verdict, findings, place=path, consequence=f"{folder.path} was written")
    if failed:
        click.get_current_context().exit(DataError.exit_code)


def _only(recording: Recording, axes: tuple[str, ...]) -> Recording:
    """Return the recording with only these axes; with all axes if none is named."""
    chosen = tuple(series for series in recording.series if not axes or series.name in axes)
    missing = [name for name in axes if name not in {series.name for series in recording.series}]
    if missing:
        found = ", ".join(series.name for series in recording.series) or "none"
        raise DataError(f"no axis {', '.join(missing)}; found {found}", place=recording.source.path)
    return replace(recording, series=chosen)


def _decompose_axis(
    series: AxisSeries, fit: "NoiseFit", files: "FilesOfFolder", *, clean: bool, **asked: Any  # noqa: ANN401
) -> dict[str, object]:  # fmt: skip
    """Decompose one axis and write its files; return its entry of the document."""
    from imucal.fitting.decomposition import decompose
    from imucal.fitting.regressors import parse
    from imucal.report.decomposition_files import axis_document, write_decomposition

    taken = fit.settings.get("regressors")
    if isinstance(taken, list) and taken:
        named = dict.fromkeys(parse(str(name)).description for name in taken)
        text = f"the fit removed {' and '.join(named)}; the bias shown here still contains it"
        print_note(f"{series.name}: {text}")
    with progress(f"decomposing {series.name}", "TaskProgressColumn") as update:
        parts = decompose(series, fit, clean=clean, progress=update)
    paths = write_decomposition(parts, files, **asked)
    return axis_document(parts, paths)


def _table(axes: list[dict[str, Any]]) -> str:
    """Return a table with one row per axis and part: range and standard error, in SI."""
    row = "{name:<9}{key:<7}{least:>12.4g}{greatest:>12.4g}{standard_error:>11.2g}  {unit}".format_map
    parts = (axis | part for axis in axes for part in axis["components"])
    # Adding 0.0 turns -0.0 into 0.0.
    rows = (row(one | {name: one[name] + 0.0 for name in ("least", "greatest")}) for one in parts)
    return "\n".join([f"{'axis':<9}{'part':<7}{'least':>12}{'greatest':>12}{'± (1 sd)':>11}  unit", *rows])

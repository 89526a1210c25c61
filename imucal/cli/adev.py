"""``imucal adev``: only the Allan curves."""

from typing import Any

import click

from imucal._version import __version__
from imucal.cli._printing import echo, picked, print_findings, print_json, print_note, refuse
from imucal.cli.log_request import LogRequest
from imucal.cli.options import ADVANCED, OUTPUT, Command, flag, force, level, log_options, option, unwrapped
from imucal.cli.param_types import TAUS
from imucal.errors import DataError
from imucal.findings import Finding, as_sentence
from imucal.grading import judge_findings
from imucal.recording import AxisSeries, Recording

_EPILOG = unwrapped("""
Examples:
  imucal adev log.mcap > curves.csv
  imucal adev log.bag --taus decade:20
  imucal adev log.csv --taus 0.1,1,10,10min --json

Exit codes: 0 done, 2 usage, 3 the log can't be read, 4 the data can't be
analysed or are not noise at rest (with --strict: or a warning was found).
""")


@click.command(cls=Command, epilog=_EPILOG)
@force
@flag("--json", "as_json", group=OUTPUT, help="Print JSON instead of CSV, with the spectrum of each axis.")
@log_options
@level
@option(
    "--taus",
    group=ADVANCED,
    metavar="SET",
    type=TAUS,
    default="octave",
    show_default=True,
    help="Averaging times: octave, decade, decade:20, all, or a list such as 0.1,1,10min.",
)
def command(
    *,
    request: LogRequest,
    taus: str | tuple[float, ...],
    level: float,
    as_json: bool,
) -> None:
    """Print the Allan deviations of every axis of LOG as CSV or JSON.

    The deviations are overlapping Allan deviations of the rate signal, in rad/s and m/s^2. The columns
    low and high are the limits of the interval; edf is its degrees of freedom. Averaging times end where
    about 2 degrees of freedom are left, except with --taus all.
    """
    recording = request.read()
    axes: list[dict[str, Any]] = []
    failures: dict[str, DataError] = {}
    for series in recording.series:
        try:
            axes.append(_axis(series, taus, level=level, spectrum=as_json))
        except DataError as error:
            failures[series.name] = error
    if not axes:
        missing = DataError("found no axis of a gyroscope or an accelerometer", place=recording.source.path)
        raise next(iter(failures.values()), missing)
    findings = _findings(recording, failures)
    verdict = judge_findings(findings, [series.name for series in recording.series])
    if as_json:
        document = {
            "schema": "imucal/adev/1",
            "version": __version__,
            "verdict": verdict.grade,
            "verdict_sentence": verdict.sentence,
            "level": level,
            "axes": axes,
        }
        print_json(document, indent=1)
    else:
        echo("\n".join(["axis,tau,m,adev,low,high,edf", *(line for a in axes for line in _lines(a))]))
    print_findings(findings)
    if verdict.usable:
        print_note(verdict.sentence)
    path = recording.source.path
    refuse(verdict, findings, place=path, consequence="the curves were printed", printed=True)


def _findings(recording: Recording, failures: dict[str, DataError]) -> list[Finding]:
    """Return the findings of reading, of screening, and of axes without a curve, as in `imucal fit`."""
    from imucal.advice import advised
    from imucal.pipeline import screen

    found = advised(recording, (*recording.findings, *screen(recording)))
    failed = [
        Finding("error", "no-result", as_sentence(error.sentence), axis=axis)
        for axis, error in failures.items()
    ]
    return [one for one in found if one.code != "no-data" or one.axis not in failures] + failed


def _axis(
    series: AxisSeries, taus: str | tuple[float, ...], *, level: float, spectrum: bool
) -> dict[str, Any]:
    """Return the entry of one axis as JSON values."""
    from imucal import allan

    if series.n and not series.usable.any():
        raise DataError(
            f"no usable samples among {series.n}: all are NaN, infinite or absurdly large",
            place=series.name,
        )
    curve = allan.allan_curve(series, taus=taus)
    low, high = curve.confidence_interval(level)
    axis: dict[str, Any] = {
        **picked(series, "name sensor axis unit"),
        "samples": curve.n,
        "rate_hz": series.rate_hz,
        "computed": curve.computed,
        "curve": {
            **picked(curve, "tau_s=tau m adev"),
            "low": low.tolist(),
            "high": high.tolist(),
            "edf": curve.edf.tolist(),
        },
    }
    if spectrum:
        psd = allan.spectrum(series)
        two_sided = {"unit": f"({series.unit})^2/Hz", "sided": "two"}
        axis["spectrum"] = two_sided | picked(psd, "frequency_hz=frequency psd count")
    return axis


def _lines(axis: dict[str, Any]) -> list[str]:
    """Return the CSV lines of one axis, with nine digits: more than an interval supports."""
    columns = zip(*axis["curve"].values(), strict=True)
    return [
        f"{axis['name']},{tau:.12g},{m},{adev:.9g},{low:.9g},{high:.9g},{edf:.6g}"
        for tau, m, adev, low, high, edf in columns
    ]

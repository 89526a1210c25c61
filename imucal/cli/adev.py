"""``imucal adev``: the curves alone."""

from collections.abc import Sequence
from typing import Any

import click

from imucal._version import __version__
from imucal.allan.intervals import EDF_METHODS
from imucal.allan.variance import ESTIMATORS
from imucal.cli._declared import declared, flag, shown
from imucal.cli._printing import echo, picked, print_findings, print_json, refuse, say
from imucal.cli.parameters import FORCE, LEVEL, LOG, TAUS, LogRequest
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.grading import judge_findings
from imucal.recording import AxisSeries, Recording


@declared(
    epilog="""\b
Examples:
  imucal adev log.mcap > curves.csv
  imucal adev log.bag --taus decade:20 --estimator modified
  imucal adev log.csv --taus 0.1,1,10,10min --json

\b
Exit codes: 0 done, 2 usage, 3 the log can't be read, 4 the data can't be
analysed or are not noise at rest (with --strict: or a warning was found)."""
)
def command(
    *,
    request: LogRequest = LOG,
    taus: str | tuple[float, ...] = shown(
        *("--taus", "octave", "octave, decade, decade:20, all, or times such as 0.1,1,10min."),
        *(TAUS, "SET"),
    ),
    estimator: str = shown("--estimator", "overlapping", "Which deviation.", click.Choice(list(ESTIMATORS))),
    edf: str = shown(
        "--edf", "hybrid", "Degrees of freedom of the intervals.", click.Choice(list(EDF_METHODS))
    ),
    level: float = shown("--level", 0.95, "Confidence level of the intervals.", LEVEL),
    as_json: bool = flag("--json", "Print JSON, with the spectrum of each axis, not CSV."),
    force: bool = FORCE,
) -> None:
    """Print the Allan deviations of every axis of LOG as CSV or JSON.

    Deviations are of the rate signal, in rad/s and m/s^2; low and high are the limits of their
    interval, edf its degrees of freedom. Sets of averaging times but "all" stop where a value has
    some 2 degrees of freedom left.
    """
    recording = request.read()
    axes: list[dict[str, Any]] = []
    failures: dict[str, DataError] = {}
    for series in recording.series:
        try:
            axes.append(_axis(series, taus, estimator=estimator, edf=edf, level=level, spectrum=as_json))
        except DataError as error:
            failures[series.name] = error
    if not axes:
        msg = f"{recording.source.path}: no axis of a gyroscope or an accelerometer was found"
        raise next(iter(failures.values()), DataError(msg))
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
    print_findings(findings, quiet=request.quiet, verbose=request.verbose)
    say(verdict.sentence, quiet=request.quiet or not verdict.usable)
    forbidden = findings if request.strict else ()
    path = recording.source.path
    refuse(verdict, path, "the curves were printed", force=force, forbidden=forbidden, told=True)


def _findings(recording: Recording, failures: dict[str, DataError]) -> list[Finding]:
    """Return what `imucal fit` would say too: of reading, of screening, and of axes without a curve."""
    from imucal.pipeline import screen

    found = (*recording.findings, *screen(recording))
    failed = [
        Finding(level="error", code="no-result", axis=axis, text=f"{error}.")
        for axis, error in failures.items()
    ]
    return [one for one in found if one.code != "no-data" or one.axis not in failures] + failed


def _axis(
    series: AxisSeries, taus: str | Sequence[float], *, estimator: str, edf: str, level: float, spectrum: bool
) -> dict[str, Any]:
    """Return what is printed of one axis, as JSON values."""
    from imucal import allan

    if series.n and not series.usable.any():
        msg = f"{series.name}: no finite samples among {series.n}"
        raise DataError(msg)
    curve = allan.allan_curve(series, taus=taus, estimator=estimator, edf=edf)
    low, high = curve.confidence_interval(level)
    axis: dict[str, Any] = {
        **picked(series, "name", "sensor", "axis", "unit"),
        "samples": curve.n,
        "rate_hz": series.rate_hz,
        **picked(curve, "estimator", "computed", "edf_method"),
        "curve": {
            "tau_s": curve.tau.tolist(),
            "m": curve.m.tolist(),
            "adev": curve.adev.tolist(),
            "low": low.tolist(),
            "high": high.tolist(),
            "edf": curve.edf.tolist(),
        },
    }
    if spectrum:
        psd = allan.spectrum(series)
        axis["spectrum"] = {
            "unit": f"({series.unit})^2/Hz",
            "sided": "two",
            "frequency_hz": psd.frequency.tolist(),
            "psd": psd.psd.tolist(),
            "count": psd.count.tolist(),
        }
    return axis


def _lines(axis: dict[str, Any]) -> list[str]:
    """Return the CSV lines of one axis: nine digits, which is more than an interval supports."""
    columns = zip(*axis["curve"].values(), strict=True)
    return [
        f"{axis['name']},{tau:.12g},{m},{adev:.9g},{low:.9g},{high:.9g},{edf:.6g}"
        for tau, m, adev, low, high, edf in columns
    ]

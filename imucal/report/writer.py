"""Write the report folder: report.json, the page, pictures, and a JSON file for each axis."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from imucal.findings import Finding
from imucal.recording import Sensor
from imucal.report.document import SCHEMA
from imucal.report.json_file import SIGNAL_FILE, axis_document, signal_document, to_document
from imucal.report.out_folder import OutFolder
from imucal.report.result import Report
from imucal.report.typed_json import dumps
from imucal.side_work import try_side_work

if TYPE_CHECKING:
    from imucal.report.figure import Drawings

_REPORT = "report.json"
_OWN = re.compile(r"report\.(json|html)|signal\.json|(gyro|accel)(_[xyz])?\.(json|png|svg|pdf)")


def write_report(
    report: Report,
    out: str | Path,
    *,
    formats: Sequence[str] = ("png",),
    html: bool = True,
    on_finding: Callable[[Finding], None] | None = None,
    workers: int | None = None,
) -> tuple[Path, ...]:
    """Write the report folder `out`; return its files, report.json first.

    A picture or page that can't be drawn is left out and becomes a finding in report.json.

    Parameters
    ----------
    out
        An existing report of imucal is replaced, other files are kept.
    formats
        Formats of the pictures: ``png``, ``svg``, ``pdf``; empty for none.
    html
        Whether to write the page.
    on_finding
        Called with the finding of each picture or page that was left out.
    workers
        Largest number of pictures drawn in parallel, as in `imucal.fit`.

    Raises
    ------
    WriteError
        If the folder can't be written, or contains foreign files.
    ValueError
        If a format is unknown.
    """
    folder = _folder(out)
    folder.refuse_foreign()
    return folder.write(
        report_files(report, formats=formats, html=html, on_finding=on_finding, workers=workers)
    )


def report_files(
    report: Report,
    *,
    formats: Sequence[str] = ("png",),
    html: bool = True,
    on_finding: Callable[[Finding], None] | None = None,
    workers: int | None = None,
) -> dict[str, bytes]:
    """Return name -> content of the files of `write_report`, report.json first."""
    from imucal.report.figure import check_format, draw, picture_names

    for form in formats:
        check_format(form)
    drawings = draw(report, formats, page=html, workers=workers)
    contents = _contents(report, drawings, html=html, on_finding=on_finding or (lambda _: None))
    names = _names(report, picture_names(report, formats))
    return {name: contents[name] for name in names if name in contents}


def check_folder(out: str | Path) -> None:
    """Raise a WriteError if `write_report` can't write to a folder."""
    _folder(out).check()


def _folder(out: str | Path) -> OutFolder:
    return OutFolder(path=Path(out), what="imucal report", document=_REPORT, schema=SCHEMA, own=_OWN)


def _names(report: Report, pictures: Sequence[str]) -> tuple[str, ...]:
    stems = [*(axis.name for axis in report.axes), *(sensor.short for sensor in Sensor)]
    names = [_REPORT, "report.html", SIGNAL_FILE]
    for stem in stems:
        names += [f"{stem}.json", *(n for n in pictures if n.rpartition(".")[0] == stem)]
    return tuple(names)


def _contents(
    report: Report, drawings: "Drawings", *, html: bool, on_finding: Callable[[Finding], None]
) -> dict[str, bytes]:
    """Return name -> content; page and report.json list failed pictures."""
    contents: dict[str, bytes] = dict(drawings.files)
    failures = tuple(drawings.failures)
    report = report.with_findings(failures)
    if html:
        from imucal.report import page

        text, failed = try_side_work(
            lambda: page.render_page(report, drawings=drawings).encode(),
            None,
            what="report.html was left out",
            code="not-drawn",
        )
        if text is not None:
            contents["report.html"] = text
        report = report.with_findings(failed)
        failures += failed
    contents[SIGNAL_FILE] = dumps(signal_document(report)).encode()
    contents[_REPORT] = dumps(to_document(report)).encode()
    for axis in report.axes:
        contents[f"{axis.name}.json"] = dumps(axis_document(report, axis)).encode()
    for failure in failures:
        on_finding(failure)
    return contents

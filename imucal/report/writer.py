"""The report folder: every file whole, the old report in place until the new one is complete.

All files are first written, and forced to disk, in a scratch folder on the same file system. A new
report folder then appears in one step; in an existing one each file takes its place in one step, and
report.json comes last: until then one stands there that says that the report is incomplete. Whatever
fails before, Ctrl-C included, leaves what was there. Two that write one folder take turns.
"""

import errno
import json
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from imucal.arguments import takes
from imucal.atomic import alone, sweep, sync_folder
from imucal.errors import WriteError
from imucal.findings import Finding
from imucal.processes import try_side_work
from imucal.recording import Sensor
from imucal.report.json_file import (
    SCHEMA,
    SIGNAL_FILE,
    axis_document,
    dumps,
    signal_document,
    to_document,
)
from imucal.report.result import Report

if TYPE_CHECKING:
    from imucal.report.figure import Drawings

_REPORT, _BEGUN = "report.json", "begun.json"
#: What stands in the place of a report that is on its way.
_INCOMPLETE = "its files were being replaced; write the report again"
#: Files this module writes, in any version and with any settings.
_OURS = re.compile(r"report\.(json|html)|signal\.json|(gyro|accel)(_[xyz])?(-paper)?\.(json|png|svg|pdf)")
_SCRATCH = re.compile(r"\.imucal-.*\.tmp")
#: Of a foreign folder's files, the message names so many.
_NAMED = 3


@takes('imucal.write_report(report, "folder")', report=Report, out=(str, Path))
def write_report(
    report: Report,
    out: str | Path,
    *,
    formats: Sequence[str] = ("png",),
    html: bool = True,
    paper: bool = False,
    tell: Callable[[Finding], None] | None = None,
    workers: int | None = None,
) -> tuple[Path, ...]:
    """Write the report folder `out`; return its files, report.json first.

    A picture or page that can't be drawn is left out; a finding in report.json says so.

    Parameters
    ----------
    out
        The folder. A report that imucal wrote there is replaced, other files in it are kept.
    formats
        Of the pictures: ``png``, ``svg``, ``pdf``; empty for none.
    html
        Whether to write the page.
    paper
        Whether to draw the curves for one column of a paper too, such as ``gyro-paper.pdf``.
    tell
        Called with the finding of each picture or page that was left out.
    workers
        Most pictures that are drawn at a time, as in `imucal.characterize`.

    Raises
    ------
    WriteError
        If the folder can't be written, or holds something that is not imucal's.
    ValueError
        If a format is unknown.
    """
    out = Path(out)
    from imucal.report.figure import check_format, draw, picture_names

    for form in formats:
        check_format(form)
    names = _names(report, picture_names(report, formats, paper=paper), html=html)
    with _translated(out):
        _refuse_foreign(out, names)
        with _scratch(out) as scratch:
            drawings = draw(report, formats, page=html, paper=paper, workers=workers)
            written = _write_all(report, drawings, names, scratch, tell or (lambda _: None))
            sync_folder(scratch)
            names = tuple(name for name in names if name in written)
            _publish(scratch, out, names)
    return tuple(out / name for name in names)


def check_folder(out: Path) -> None:
    """Refuse a folder that `write_report` could not write to, by a WriteError, before hours of work."""
    out = Path(out)
    with _translated(out):
        _refuse_foreign(out, ())
        home = home_of(out)
        fine = {errno.ENOTDIR: home.is_dir(), errno.EACCES: os.access(home, os.W_OK | os.X_OK)}
        if wrong := [code for code in fine if not fine[code]]:
            raise OSError(wrong[0], os.strerror(wrong[0]))


def _names(report: Report, pictures: Sequence[str], *, html: bool) -> tuple[str, ...]:
    """Return the files of a report in the order in which they take their places."""
    stems = [*(axis.name for axis in report.axes), *(sensor.short for sensor in Sensor)]
    names = [_REPORT, *(["report.html"] if html else []), SIGNAL_FILE]
    for stem in stems:
        names += [f"{stem}.json"] if stem in {axis.name for axis in report.axes} else []
        names += [name for name in pictures if name.rpartition(".")[0] in {stem, f"{stem}-paper"}]
    return tuple(names)


def _write_all(
    report: Report, drawings: "Drawings", names: Sequence[str], scratch: Path, tell: Callable[[Finding], None]
) -> set[str]:
    """Write each file, pictures first, so that page and JSON say which are missing; return those written."""
    written = set(drawings.files) & set(names)
    for name in written:
        _write(scratch / name, drawings.files[name])
    failures = tuple(drawings.failures)
    report = replace(report, findings=report.findings + failures)
    if "report.html" in names:
        from imucal.report import html_page

        page, failed = try_side_work(
            lambda: html_page.render_page(report, drawings=drawings).encode(),
            None,
            what="report.html was left out",
            code="not-drawn",
        )
        if page is not None:
            _write(scratch / "report.html", page)
            written.add("report.html")
        report = replace(report, findings=report.findings + failed)
        failures += failed
    _write(scratch / SIGNAL_FILE, dumps(signal_document(report)).encode())
    _write(scratch / _REPORT, dumps(to_document(report)).encode())
    for axis in report.axes:
        _write(scratch / f"{axis.name}.json", dumps(axis_document(report, axis)).encode())
    for failure in failures:
        tell(failure)
    return written | {_REPORT, SIGNAL_FILE, *(f"{axis.name}.json" for axis in report.axes)}


@contextmanager
def _translated(out: Path) -> Iterator[None]:
    """Turn what the operating system says into a `WriteError` with advice."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        advice = {
            **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "free some space"),
            **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "choose a folder you may write to"),
        }.get(error.errno or 0, "choose another folder")
        msg = f"{out}: the report can't be written: {reason}; nothing was changed; {advice}"
        raise WriteError(msg) from error


def _refuse_foreign(out: Path, names: tuple[str, ...]) -> None:
    """Raise unless `out` is missing, empty, or a report folder where `names` may be replaced."""
    if (held := held_by(out)) and not _is_report(out / _REPORT):
        msg = f"{out}: contains {held} but no imucal report; nothing was changed; choose another folder"
        raise WriteError(msg)
    for name in names:
        if (out / name).is_dir():
            raise WriteError(f"{out / name}: is a folder, expected a file of the report; move it away")


def held_by(out: Path) -> str:
    """Return the first names of what a folder holds; a WriteError where a file stands in its place."""
    if not os.path.lexists(out):
        return ""
    if not out.is_dir():
        msg = f"{out}: is a file, expected a folder or nothing; move it away or choose another folder"
        raise WriteError(msg)
    entries = sorted(path.name for path in out.iterdir() if not _SCRATCH.fullmatch(path.name))
    return ", ".join(entries[:_NAMED]) + (", …" if len(entries) > _NAMED else "")


def home_of(out: Path) -> Path:
    """Return the folder that is there of a path: itself, or the nearest above it."""
    return next(folder for folder in (out, *out.absolute().parents) if folder.exists())


def _is_report(path: Path) -> bool:
    try:
        schema = json.loads(path.read_bytes()).get("schema")
    except (OSError, ValueError, AttributeError):
        return False
    return isinstance(schema, str) and schema.startswith("imucal/report/")


@contextmanager
def _scratch(out: Path) -> Iterator[Path]:
    """Yield a scratch folder on the file system of `out`; it is removed whatever happens."""
    home = out if out.is_dir() else out.parent
    home.mkdir(parents=True, exist_ok=True)
    sweep(path for path in home.iterdir() if _SCRATCH.fullmatch(path.name))
    folder = home / f".imucal-{secrets.token_hex(8)}.tmp"
    # Unlike mkdtemp, mkdir gives the folder the rights that the user's umask allows.
    folder.mkdir()
    try:
        yield folder
    finally:
        with suppress(OSError):
            shutil.rmtree(folder)


def _write(path: Path, content: bytes) -> None:
    with path.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def _publish(scratch: Path, out: Path, names: tuple[str, ...]) -> None:
    """Move the complete files to their places, then remove what an older report left over."""
    if not out.exists():
        try:
            scratch.rename(out)
        except OSError:
            # Another run may have made it meanwhile.
            if not out.is_dir():
                raise
        else:
            sync_folder(out.parent)
            return
    moved = 0
    try:
        with alone(out):
            _write(scratch / _BEGUN, dumps({"schema": SCHEMA, "incomplete": _INCOMPLETE}).encode())
            (scratch / _BEGUN).replace(out / _REPORT)
            for moved, name in enumerate((*names[1:], _REPORT)):  # noqa: B007 - the message counts them
                (scratch / name).replace(out / name)
            for path in out.iterdir():
                if _OURS.fullmatch(path.name) and path.name not in names and path.is_file():
                    path.unlink()
    except OSError as error:
        msg = (
            f"{out}: only {moved} of {len(names)} files were replaced: {error.strerror or error}; the report "
            "is incomplete; write it again"
        )
        raise WriteError(msg) from error
    sync_folder(out)

"""The report folder: every file whole, the old report in place until the new one is complete.

All files are first written, and forced to disk, in a scratch folder on the same file system. A new
report folder then appears in one step; in an existing one each file takes its place in one step,
report.json first, so that the folder is known as imucal's own from then on. Whatever fails
before, Ctrl-C included, leaves what was there.
"""

import errno
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from imucal.atomic import sync_folder
from imucal.errors import WriteError
from imucal.findings import Finding
from imucal.recording import Sensor
from imucal.report.document import axis_document, to_document
from imucal.report.json_file import dumps
from imucal.report.result import AxisReport, Report
from imucal.side_work import try_side_work

_REPORT = "report.json"
#: Files this module writes, in any version and with any settings.
_OURS = re.compile(r"report\.(json|html)|(gyro|accel)(_[xyz])?\.(json|png|svg|pdf)")
_SCRATCH = re.compile(r"\.imucal-.*\.tmp")
#: A scratch folder older than this, in s, was left by a run that was killed.
_ABANDONED_S = 3600.0
#: Of a foreign folder's files, the message names so many.
_NAMED = 3


def write_report(
    report: Report,
    out: Path,
    *,
    formats: Sequence[str] = ("png",),
    html: bool = True,
    tell: Callable[[Finding], None] | None = None,
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
    tell
        Called with the finding of each picture or page that was left out.

    Raises
    ------
    WriteError
        If the folder can't be written, or holds something that is not imucal's.
    ValueError
        If a format is unknown.
    """
    out = Path(out)
    renderers = _renderers(report, formats, html=html)
    with _translated(out):
        _refuse_foreign(out, tuple(renderers))
        with _scratch(out) as scratch:
            left_out = _write_all(report, renderers, scratch, tell or (lambda _: None))
            sync_folder(scratch)
            names = tuple(name for name in renderers if name not in left_out)
            _publish(scratch, out, names)
    return tuple(out / name for name in names)


def check_folder(out: Path) -> None:
    """Refuse a folder that `write_report` could not write to, before hours of data are fitted.

    Raises
    ------
    WriteError
        If it holds something that is not imucal's, or may not be written to.
    """
    out = Path(out)
    with _translated(out):
        _refuse_foreign(out, ())
        home = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
        if not home.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not os.access(home, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def _renderers(report: Report, formats: Sequence[str], *, html: bool) -> dict[str, Callable[[Report], bytes]]:
    """Return what makes each file of a report, in the order in which they take their places."""
    from imucal.report.figure import FORMATS, axis_figure, render, sensor_figure

    unknown = [form for form in formats if form not in FORMATS]
    if unknown:
        msg = f"format {unknown[0]!r} is not one of {', '.join(FORMATS)}"
        raise ValueError(msg)
    # One drawing of an axis serves the page and every format.
    drawn = cache(axis_figure)

    def picture(axis: AxisReport, form: str, told: Report) -> bytes:
        return render(drawn(told, axis), form, version=told.version)

    def overview(sensor: Sensor, form: str, told: Report) -> bytes:
        return render(sensor_figure(told, sensor), form, version=told.version)

    made: dict[str, Callable[[Report], bytes]] = {_REPORT: lambda told: dumps(to_document(told)).encode()}
    if html:
        from imucal.report.html_page import render_page

        made["report.html"] = lambda told: render_page(told, picture=partial(drawn, told)).encode()
    for axis in report.axes:
        made[f"{axis.name}.json"] = partial(_axis_json, axis)
        for form in formats:
            made[f"{axis.name}.{form}"] = partial(picture, axis, form)
    for sensor in Sensor:
        if any(axis.sensor is sensor for axis in report.axes):
            for form in formats:
                made[f"{sensor.short}.{form}"] = partial(overview, sensor, form)
    return made


def _write_all(
    report: Report,
    renderers: Mapping[str, Callable[[Report], bytes]],
    scratch: Path,
    tell: Callable[[Finding], None],
) -> set[str]:
    """Write each file, pictures first, so that page and JSON say which are missing; return those."""
    left_out = set()
    for name in sorted(renderers, key=lambda name: (name.endswith(".json"), name.endswith(".html"))):
        if name.endswith(".json"):
            _write(scratch / name, renderers[name](report))
            continue
        content, failed = try_side_work(
            partial(renderers[name], report), None, what=f"{name} was left out", code="not-drawn"
        )
        if content is not None:
            _write(scratch / name, content)
            continue
        left_out.add(name)
        report = replace(report, findings=report.findings + failed)
        for finding in failed:
            tell(finding)
    return left_out


def _axis_json(axis: AxisReport, report: Report) -> bytes:
    return dumps(axis_document(report, axis)).encode()


@contextmanager
def _translated(out: Path) -> Iterator[None]:
    """Turn what the operating system says into a `WriteError` with advice."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        advice = {
            errno.ENOSPC: "free some space",
            errno.EDQUOT: "free some space",
            errno.EACCES: "choose a folder you may write to",
            errno.EPERM: "choose a folder you may write to",
            errno.EROFS: "choose a folder you may write to",
        }.get(error.errno or 0, "choose another folder")
        msg = f"{out}: the report can't be written: {reason}; nothing was changed; {advice}"
        raise WriteError(msg) from error


def _refuse_foreign(out: Path, names: tuple[str, ...]) -> None:
    """Raise unless `out` is missing, empty, or a report folder where `names` may be replaced."""
    if not os.path.lexists(out):
        return
    if not out.is_dir():
        msg = f"{out}: is a file, expected a folder or nothing; move it away or choose another folder"
        raise WriteError(msg)
    entries = sorted(path.name for path in out.iterdir() if not _SCRATCH.fullmatch(path.name))
    if entries and not _is_report(out / _REPORT):
        shown = ", ".join(entries[:_NAMED]) + (", …" if len(entries) > _NAMED else "")
        msg = f"{out}: holds {shown} but no report of imucal's; nothing was changed; choose another folder"
        raise WriteError(msg)
    for name in names:
        if (out / name).is_dir():
            msg = f"{out / name}: is a folder, expected a file of the report; move it away"
            raise WriteError(msg)


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
    _sweep(home)
    folder = home / f".imucal-{secrets.token_hex(8)}.tmp"
    # Unlike mkdtemp, mkdir gives the folder the rights that the user's umask allows.
    folder.mkdir()
    try:
        yield folder
    finally:
        with suppress(OSError):
            shutil.rmtree(folder)


def _sweep(home: Path) -> None:
    """Remove scratch folders that killed runs have left."""
    for path in home.iterdir():
        with suppress(OSError):
            if _SCRATCH.fullmatch(path.name) and time.time() - path.stat().st_mtime > _ABANDONED_S:
                shutil.rmtree(path)


def _write(path: Path, content: bytes) -> None:
    with path.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def _publish(scratch: Path, out: Path, names: tuple[str, ...]) -> None:
    """Move the complete files to their places, then remove what an older report left over."""
    if not out.exists():
        scratch.rename(out)
        sync_folder(out.parent)
        return
    moved = 0
    try:
        for moved, name in enumerate(names):  # noqa: B007 - the message counts them
            (scratch / name).replace(out / name)
        for path in out.iterdir():
            if _OURS.fullmatch(path.name) and path.name not in names and path.is_file():
                path.unlink()
    except OSError as error:
        msg = (
            f"{out}: only {moved} of {len(names)} files were replaced: {error.strerror or error}; "
            "each file is whole, but old and new ones stand together; write the report again"
        )
        raise WriteError(msg) from error
    sync_folder(out)

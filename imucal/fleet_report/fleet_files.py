"""The files of a fleet's report, in its folder: ``fleet.json``, ``fleet.csv``, ``fleet.html``, pictures."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from imucal.atomic import replacing
from imucal.errors import WriteError
from imucal.findings import Finding
from imucal.fleet_report.fleet_document import fleet_csv, fleet_json
from imucal.fleet_report.summary import Fleet
from imucal.side_work import try_side_work


def write_fleet(
    fleet: Fleet,
    out: str | Path | None = None,
    *,
    pictures: bool = True,
    html: bool = True,
    tell: Callable[[Finding], None] | None = None,
) -> tuple[Path, ...]:
    """Write what is known of a fleet; return the files, ``fleet.json`` first.

    Each file takes its place whole. A picture or page that can't be drawn is left out, also in the place of
    an old one, and a finding in ``fleet.json`` says so.

    Parameters
    ----------
    fleet
        From `imucal.load_fleet`.
    out
        The folder; the fleet's own where none is given.
    pictures, html
        Whether to write PNGs and the page.
    tell
        Called with the finding of each picture or page that was left out.

    Raises
    ------
    WriteError
        If a file can't be written.
    """
    folder = fleet.folder if out is None else Path(out)
    made: dict[str, Callable[[], bytes]] = {}
    if pictures:
        from imucal.fleet_report.fleet_figures import fleet_figures

        made |= fleet_figures(fleet)
    tell = tell or (lambda _: None)
    drawn: dict[str, bytes | None] = {}
    for name, make in made.items():
        fleet, drawn[name] = _drawn(fleet, name, make, tell)
    if html:
        from imucal.fleet_report.fleet_page import render_fleet_page

        # Last: where it is newer than the store, all of the report is.
        page = partial(render_fleet_page, fleet)
        fleet, drawn["fleet.html"] = _drawn(fleet, "fleet.html", lambda: page().encode(), tell)
    drawn = {"fleet.json": fleet_json(fleet).encode(), "fleet.csv": fleet_csv(fleet).encode(), **drawn}
    for name, data in drawn.items():
        if data is None:
            _remove(folder / name)
            continue
        with replacing(folder / name) as scratch:
            scratch.write_bytes(data)
    return tuple(folder / name for name, data in drawn.items() if data is not None)


def _drawn(
    fleet: Fleet, name: str, make: Callable[[], bytes], tell: Callable[[Finding], None]
) -> tuple[Fleet, bytes | None]:
    """Return a picture or page, and the fleet with a finding where it is None."""
    data, failed = try_side_work(make, None, what=f"{name} is missing", code="not-drawn")
    for finding in failed:
        tell(finding)
    return replace(fleet, findings=fleet.findings + failed), data


def _remove(file: Path) -> None:
    """Remove an old picture or page: it would be taken for that of the new numbers."""
    try:
        file.unlink(missing_ok=True)
    except OSError as error:
        msg = f"{file}: can't be removed: {error.strerror or error}; remove it, it is out of date"
        raise WriteError(msg) from error

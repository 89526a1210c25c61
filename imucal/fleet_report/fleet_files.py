"""The files of a fleet's report, in its folder: ``fleet.json``, ``fleet.csv``, ``fleet.html``, pictures."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from imucal.atomic import replacing
from imucal.fleet_report.fleet_document import fleet_csv, fleet_json
from imucal.fleet_report.summary import Fleet
from imucal.side_work import try_side_work

if TYPE_CHECKING:
    from collections.abc import Callable


def write_fleet(
    fleet: Fleet, out: str | Path | None = None, *, pictures: bool = True, html: bool = True
) -> tuple[Path, ...]:
    """Write what is known of a fleet; return the files, ``fleet.json`` first.

    Each file takes its place whole. A picture or page that can't be drawn is left out, and a finding in
    ``fleet.json`` says so.

    Parameters
    ----------
    fleet
        From `imucal.load_fleet`.
    out
        The folder; the fleet's own where none is given.
    pictures, html
        Whether to write PNGs and the page.

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
    drawn: dict[str, bytes] = {}
    for name, make in made.items():
        data, failed = try_side_work(make, None, what=f"{name} is missing", code="not-drawn")
        fleet = replace(fleet, findings=fleet.findings + failed)
        if data is not None:
            drawn[name] = data
    if html:
        from imucal.fleet_report.fleet_page import render_fleet_page

        told = fleet
        page, failed = try_side_work(
            lambda: render_fleet_page(told).encode(), None, what="fleet.html is missing", code="not-drawn"
        )
        fleet = replace(fleet, findings=fleet.findings + failed)
        if page is not None:
            # Last: where it is newer than the store, all of the report is.
            drawn["fleet.html"] = page
    drawn = {"fleet.json": fleet_json(fleet).encode(), "fleet.csv": fleet_csv(fleet).encode(), **drawn}
    for name, data in drawn.items():
        with replacing(folder / name) as scratch:
            scratch.write_bytes(data)
    return tuple(folder / name for name in drawn)

"""``imucal fleet status``: what of a fleet is done, what failed and why, what is left."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._fleet import count, number_of, print_failures, print_standing
from imucal.cli._printing import as_typed, echo, print_json, say
from imucal.cli.parameters import json_option, quiet_option
from imucal.grading import GRADES

if TYPE_CHECKING:
    import polars as pl


@click.command(
    epilog="""\b
Examples:
  imucal fleet status fleet
  imucal fleet status fleet --json | jq .left"""
)
@click.argument("folder", type=click.Path(path_type=Path), metavar="FLEET")
@json_option("Print it as JSON.")
@quiet_option
def command(*, folder: Path, as_json: bool, quiet: bool) -> None:
    """Say what of FLEET is done, what failed and why, and what is left; while it runs, too."""
    from imucal.fleet.store import FleetStore

    store = FleetStore(folder)
    manifest = store.manifest()
    store.refuse_damage()
    logs = store.logs()
    copies = manifest.drop_nulls("copy_of")
    settled = {*logs["path"], *copies["path"]}
    left = [path for path in manifest["path"] if path not in settled]
    if as_json:
        print_json(_document(logs, manifest, left))
        return
    print_standing(logs, folder)
    print_failures(logs, quiet=quiet)
    for path, other in copies.select("path", "copy_of").iter_rows():
        say(f"  {path}: same content as {other}, counted once", quiet=quiet)
    if left:
        left_of = f"{len(left)} of {number_of(manifest.height, 'log')}"
        echo(f"left: {left_of}; imucal fleet run -o {as_typed(folder)} goes on")


def _document(logs: "pl.DataFrame", manifest: "pl.DataFrame", left: list[str]) -> dict[str, object]:
    from imucal.fleet.store import STATUSES

    copies = manifest.drop_nulls("copy_of").select("path", "copy_of").iter_rows()
    return {
        "asked": manifest.height,
        "done": logs.height,
        "statuses": {status: count(logs, status) for status in STATUSES},
        "verdicts": {grade: count(logs, "ok", grade) for grade in GRADES},
        "copies": dict(copies),
        "left": left,
        "bytes": int(logs["bytes"].sum() or 0),
        "cpu_s": float(logs["cpu_s"].sum() or 0.0),
    }

"""``imucal fleet report`` and ``imucal fleet status``: what the units of a fleet are like, what is done."""

from pathlib import Path
from typing import TYPE_CHECKING

from imucal.cli._declared import argument, declared, flag, option, shown
from imucal.cli._fleet import count, number_of, print_failures, print_standing, say_verdict
from imucal.cli._printing import as_typed, echo, print_json, say
from imucal.cli.parameters import PATH, QUIET, SHARE
from imucal.grading import GRADES

if TYPE_CHECKING:
    from imucal.findings import Finding


@declared(
    epilog="""\b
Examples:
  imucal fleet report fleet
  imucal fleet report fleet --content 0.99 --no-html
  imucal export fleet --value tolerance --to kalibr

\b
Exit codes: 0 done, 2 usage, 3 the folder is no fleet or can't be read,
4 no log is done, 5 a file can't be written."""
)
def report(
    *,
    folder: Path = argument("FLEET", PATH),
    content: float = shown("--content", 0.95, "Share of all units that the tolerance bound holds.", SHARE),
    confidence: float = shown("--confidence", 0.95, "How sure that is.", SHARE),
    html: bool = option("--html/--no-html", "Write fleet.html.", default=True),
    pictures: bool = option("--pictures/--no-pictures", "Write the PNGs.", default=True),
    quiet: bool = QUIET,
) -> None:
    """Say what the units of each sensor model are like: FLEET is the folder of 'imucal fleet run'.

    Per model, axis and term: the units with their intervals, the median unit, the spreads between units and
    between logs of one unit, where the next unit lies, and the number for the config of every unit (the
    tolerance bound) with what more units would save. Units that are odd or drift are named.
    """
    from imucal.fleet_report import load_fleet, write_fleet

    fleet = load_fleet(folder, content=content, confidence=confidence)
    missing: list[Finding] = []
    for path in write_fleet(fleet, html=html, pictures=pictures, tell=missing.append):
        echo(str(path))
    say_verdict(fleet, missing, quiet=quiet)
    if fleet.loose:
        say(f"to have them counted, run the fleet with --labels '{fleet.labels}'", quiet=quiet)


@declared(
    epilog="""\b
Examples:
  imucal fleet status fleet
  imucal fleet status fleet --json | jq .left"""
)
def status(
    *,
    folder: Path = argument("FLEET", PATH),
    as_json: bool = flag("--json", "Print it as JSON."),
    quiet: bool = QUIET,
) -> None:
    """Say what of FLEET is done, what failed and why, and what is left; while it runs, too."""
    from imucal.fleet.store import STATUSES, FleetStore

    store = FleetStore(folder)
    manifest = store.manifest()
    store.refuse_damage()
    logs = store.logs()
    copies = dict(manifest.drop_nulls("copy_of").select("path", "copy_of").iter_rows())
    settled = {*logs["path"], *copies}
    left = [path for path in manifest["path"] if path not in settled]
    if as_json:
        document = {
            "asked": manifest.height,
            "done": logs.height,
            "statuses": {status: count(logs, status) for status in STATUSES},
            "verdicts": {grade: count(logs, "ok", grade) for grade in GRADES},
            "copies": copies,
            "left": left,
            "bytes": int(logs["bytes"].sum() or 0),
            "cpu_s": float(logs["cpu_s"].sum() or 0.0),
        }
        print_json(document)
        return
    print_standing(logs, folder)
    print_failures(logs, quiet=quiet)
    for path, other in copies.items():
        say(f"  {path}: same content as {other}, counted once", quiet=quiet)
    if left:
        left_of = f"{len(left)} of {number_of(manifest.height, 'log')}"
        echo(f"left: {left_of}; imucal fleet run -o {as_typed(folder)} goes on")

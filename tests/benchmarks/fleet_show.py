"""A fleet from its logs to its page: ``python -m tests.benchmarks.fleet_show [FOLDER] [--logs 200]``.

Simulated logs of three sensor models (with broken ones, copies and one odd unit) are processed on two
workers by the real commands, and the output is compared with the truth. A given folder is kept, to inspect
its page and pictures.
"""

import argparse
import json
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.fleet.simulated_fleet import ODD, MadeLog, make_fleet

LABELS = ("--labels", "{model}/{unit}/{temperature_c}C/*.npz")
#: Fault of a log -> its possible outcomes: status, or verdict of an analysed log.
MAY_END = {
    "": {"good", "check"},
    "cut": {"unreadable"},
    "garbage": {"unreadable"},
    "empty": {"unreadable", "copy"},
    "short": {"no-data", "unreadable"},
    "moved": {"not-noise", "check"},
    "copy": {"copy"},
}


class Show:
    """The working folder, and the commands that are run in it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.wrong = folder, 0

    def type(self, *arguments: str, code: int) -> subprocess.CompletedProcess[str]:
        """Run a command, print its cost, and compare its exit code with the expected one."""
        begun, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "imucal", *arguments]
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, check=False)  # noqa: S603
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"$ imucal {' '.join(arguments)}")
        print(f"  exit {done.returncode}, {time.monotonic() - begun:.1f} s, {cpu:.1f} s of CPU", flush=True)
        self.hold(f"exit code {code}", done.returncode == code, done.stderr[-2000:])
        self.hold(
            "no traceback", "Traceback" not in done.stderr and "internal" not in done.stderr, done.stderr
        )
        return done

    def hold(self, what: str, held: bool, otherwise: object = "") -> None:  # noqa: FBT001 - a statement
        """Print and count a failed expectation."""
        if not held:
            self.wrong += 1
            print(f"  WRONG: not {what}: {otherwise}", flush=True)


def print_lines(text: str, lines: int) -> None:
    """Print the first lines of a command's output."""
    print("".join(f"  {line}\n" for line in text.splitlines()[:lines]), end="", flush=True)


def show(folder: Path, *, logs: int, seconds: float, axes: int) -> int:
    """Run all commands; return the number of failed expectations."""
    made = make_fleet(folder / "logs", logs=logs, seconds=seconds, axes=axes)
    print(f"{logs} logs of {seconds:g} s; broken: {dict(Counter(log.broken for log in made if log.broken))}")
    scene = Show(folder)
    dry = scene.type("fleet", "run", "logs", *LABELS, "--dry-run", code=0)
    scene.hold("every log in the plan", len(dry.stdout.splitlines()) == logs, dry.stdout)
    scene.hold("nothing written", not (folder / "fleet").exists())
    print_lines(dry.stderr, 1)

    run = scene.type("fleet", "run", "logs", *LABELS, "--jobs", "2", "--max-failed", "10%", code=0)
    print_lines(run.stdout + run.stderr, 40)
    status = scene.type("fleet", "status", "fleet", "--json", code=0)
    _hold_ends(scene, made, json.loads(status.stdout))

    report = scene.type("fleet", "report", "fleet", code=0)
    print_lines(report.stdout, 20)
    summary = run.stderr.strip().splitlines()[-1]
    odd = re.search("odd unit ([^.]*)", summary, re.IGNORECASE)
    scene.hold("the odd unit named", bool(odd) and ODD[1] in str(odd and odd[1]), summary)

    again = scene.type("fleet", "run", "logs", *LABELS, "--jobs", "2", "--max-failed", "10%", code=0)
    scene.hold("nothing to do", again.stderr.startswith("0 logs to do"), again.stderr)
    scene.hold("the same said", again.stdout == run.stdout, again.stdout)
    strict = scene.type("fleet", "run", "-o", "fleet", "--max-failed", "1%", code=4)
    print_lines(strict.stderr[strict.stderr.rfind("Error") :], 1)
    return scene.wrong


def _hold_ends(scene: Show, made: list[MadeLog], status: dict[str, object]) -> None:
    """Compare the outcome of each log with its fault."""
    from imucal.fleet.store import FleetStore

    done = FleetStore(scene.folder / "fleet").logs()
    ends = {
        str(row["path"]): str(row["verdict"] if row["status"] == "ok" else row["status"])
        for row in done.iter_rows(named=True)
    }
    copies = status["copies"]
    ends |= dict.fromkeys(copies, "copy") if isinstance(copies, dict) else {}
    scene.hold("every log done or a copy", len(ends) == len(made), len(ends))
    scene.hold("nothing left", status["left"] == [], status["left"])
    table: Counter[tuple[str, str]] = Counter()
    for log in made:
        end = ends.get(str(log.path.relative_to(scene.folder)), "missing")
        table[log.broken or "all right", end] += 1
        scene.hold(f"{log.broken or 'good'} log {log.path.name} as expected", end in MAY_END[log.broken], end)
    for (broken, end), count in sorted(table.items()):
        print(f"  {broken:10} -> {end:12} {count:4}", flush=True)


def main() -> None:
    """Print the run; exit with 1 if an expectation failed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--axes", type=int, choices=[1, 3], default=3, help="3 of each sensor, or one in all")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = (asked.folder or Path(scratch)).resolve()
        wrong = show(folder, logs=asked.logs, seconds=asked.seconds, axes=asked.axes)
    print(f"{wrong} things were not as they should be")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()

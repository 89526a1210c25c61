"""Damaged files of a fleet: one bit or 64 bytes are changed."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.cli.run import run

#: Number of bytes that are overwritten at once.
_SECTOR = 64
#: Commands that read a fleet, used in turn: arguments before its folder.
COMMANDS = (
    ("fleet", "report", "--no-pictures", "--no-html"),
    ("fleet", "status"),
    ("export", "--median", "--to", "kalibr", "-o", "-"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """One change of one file, and the reaction of a command.

    Attributes
    ----------
    file, what
        File of the store, and the change.
    command
        Command that read the store.
    silent
        Whether the command did not exit with 5 and a message with the file's name.
    output
        Exit code and end of the error output.
    """

    file: str
    what: str
    command: str
    silent: bool
    output: str


def damages(fleet: Path, scratch: Path, *, number: int, seed: int) -> Iterator[Damage]:
    """Yield the reactions to copies of a fleet with one change each, every second one a bit."""
    rng = np.random.default_rng(seed)
    names = sorted(
        path.relative_to(fleet)
        for path in fleet.rglob("*")
        if path.suffix == ".parquet" or path.name == "settings.json"
    )
    for count in range(number):
        folder = scratch / "damaged"
        shutil.copytree(fleet, folder)
        name = names[int(rng.integers(len(names)))]
        what = _change(folder / name, rng, bit=count % 2 == 0)
        command = COMMANDS[count % len(COMMANDS)]
        done = run(*command, str(folder), cwd=scratch)
        reported = done.returncode == 5 and str(name) in done.stderr and "Traceback" not in done.stderr
        # Only runs read the settings.
        if name.name == "settings.json":
            done = run("fleet", "run", "-o", str(folder), "--dry-run", cwd=scratch)
            reported = done.returncode == 5 and str(name) in done.stderr
        yield Damage(
            file=str(name),
            what=what,
            command=" ".join(command[:2]),
            silent=not reported,
            output=f"{done.returncode}: {done.stderr[-200:]}",
        )
        shutil.rmtree(folder)


def _change(file: Path, rng: np.random.Generator, *, bit: bool) -> str:
    data = bytearray(file.read_bytes())
    at = int(rng.integers(len(data)))
    if bit:
        data[at] ^= 1 << int(rng.integers(8))
    else:
        end = min(at + _SECTOR, len(data))
        data[at:end] = bytes(byte ^ int(rng.integers(1, 256)) for byte in data[at:end])
    file.write_bytes(data)
    return f"{'bit' if bit else '64 bytes'} at {at}"

"""Damaged files of a fleet: one bit or 64 bytes are changed."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.cli.run import run

#: Bytes that are overwritten at once, less than a line.
_SECTOR = 64
#: Commands that read a fleet, used in turn: arguments before its folder.
COMMANDS = (
    ("fleet", "report", "--no-pictures", "--no-html"),
    ("fleet", "status"),
    ("fleet", "run", "--dry-run", "-o"),
    ("export", "--median", "--to", "kalibr", "-o", "-"),
)


class Damage(NamedTuple):
    """One change of one file, and a command; `silent` without exit code 5 and a message with the file."""

    file: str
    what: str
    command: str
    silent: bool
    output: str


def damages(fleet: Path, scratch: Path, *, number: int, seed: int) -> Iterator[Damage]:
    """Yield the reactions to copies of a fleet with one change each, every second one a bit."""
    rng = np.random.default_rng(seed)
    files = sorted(fleet.glob("run-*.fleet"))
    for count in range(number):
        folder = scratch / "damaged"
        shutil.copytree(fleet, folder)
        name = files[rng.integers(len(files))].name
        data = np.frombuffer((folder / name).read_bytes(), np.uint8).copy()
        at = int(rng.integers(len(data)))
        if count % 2:
            data[at : at + _SECTOR] ^= rng.integers(1, 256, len(data[at : at + _SECTOR]), np.uint8)
        else:
            data[at] ^= 1 << rng.integers(8)
        (folder / name).write_bytes(data.tobytes())
        command = COMMANDS[count // 2 % len(COMMANDS)]
        done = run(*command, str(folder), cwd=scratch)
        yield Damage(
            file=name,
            what=f"{'64 bytes' if count % 2 else 'bit'} at {at}",
            command=" ".join(command[:2]),
            silent=done.returncode != 5 or name not in done.stderr or "Traceback" in done.stderr,
            output=f"{done.returncode}: {done.stderr[-200:]}",
        )
        shutil.rmtree(folder)

"""Damage in the files of a fleet: ``python -m tests.benchmarks.fleet_flips [--number N] [--seed S]``.

It changes one bit or 64 bytes of a file in a copy of a fleet, runs a command, and prints how often the
command did not exit with code 5 and the name of the file.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from tests.fleet.damage import damages
from tests.fleet.simulated_store import write_store


def main() -> None:
    """Print the table; exit with 1 if a damage was not reported."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--seed", type=int, default=8402)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        fleet = write_store(folder / "fleet", units=4, temperatures=(10.0, 45.0), special=False, weak="")
        found = list(damages(fleet, folder, number=given.number, seed=given.seed))
    silent = [damage for damage in found if damage.silent]
    print(f"{len(found)} damages, silent: {len(silent)}")
    for damage in silent:
        print(f"  {damage.file}, {damage.what}, {damage.command}: {damage.output}")
    sys.exit(bool(silent))


if __name__ == "__main__":
    main()

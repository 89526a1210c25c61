"""Damage in the files of a fleet: ``python -m tests.benchmarks.fleet_flips [--number N] [--seed S]``.

It changes one bit or 64 bytes of a file in a copy of a fleet, runs a command, and prints how often the
command did not exit with code 5 and the name of the file.
"""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.fleet_report.simulated_store import write_store
from tests.fleet_run.damage import damages


def main() -> None:
    """Print the table; exit with 1 if a damage was not reported."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--seed", type=int, default=8402)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        store = write_store(
            folder / "fleet", units=4, temperatures=(10.0, 45.0), special=False, bins=4, weak=""
        )
        store.keep_settings({"model": "N + B + K", "level": 0.95})
        from imucal import load_fleet

        load_fleet(store.folder)
        found = list(damages(store.folder, folder, number=given.number, seed=given.seed))
    tables = Counter(Path(damage.file).parts[0] for damage in found)
    silent = [damage for damage in found if damage.silent]
    print(f"{len(found)} damages: {', '.join(f'{table} {n}' for table, n in sorted(tables.items()))}")
    print(f"silent: {len(silent)}")
    for damage in silent:
        print(f"  {damage.file}, {damage.what}, {damage.command}: {damage.output}")
    sys.exit(bool(silent))


if __name__ == "__main__":
    main()

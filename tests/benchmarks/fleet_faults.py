"""Faults of a fleet with real processes: ``python -m tests.benchmarks.fleet_faults [NAME …] [--times N]``.

Prints for each fault how the run ended, and whether the resumed results equal the undisturbed ones.
"""

import argparse
import os
import shutil
import sys
import tempfile
import time
import traceback
from pathlib import Path

from tests.fleet.fault_scenarios import HERE, QUICK, SLOW
from tests.fleet.faults import Bench
from tests.fleet.simulated_fleet import make_fleet


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*")
    parser.add_argument("--logs", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each log")
    parser.add_argument("--times", type=int, default=1, help="how often each is done")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder).resolve())
        make_fleet(bench.folder / "logs", logs=asked.logs, seconds=asked.seconds, seed=9)
        whole = bench.run("whole", *HERE)
        print(f"undisturbed: exit {whole.code}, {len(bench.store('whole').logs())} logs", flush=True)
        failed = 0
        chosen = [f for f in (*QUICK, *SLOW) if not asked.names or f.__name__ in asked.names]
        for fault in (fault for fault in chosen for _ in range(asked.times)):
            for path in bench.folder.iterdir():
                if path.name not in {"logs", "whole"}:
                    shutil.rmtree(path)
            begun = time.monotonic()
            try:
                outcome = fault(bench)
            except Exception as error:  # noqa: BLE001 - the table contains the error, and the others run
                failed += 1
                line = traceback.extract_tb(error.__traceback__)[-1]
                outcome = f"FAILED in {line.name}:{line.lineno} {line.line}: {type(error).__name__}: {error}"
            finally:
                bench.end_runs()
            seconds = time.monotonic() - begun
            print(
                f"{fault.__name__:42} {seconds:6.1f} s, load {os.getloadavg()[0]:.1f}  {outcome}", flush=True
            )
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()

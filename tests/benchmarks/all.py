"""Run the benchmarks of time and memory one after the other: the whole job, the readers, the Allan curve.

    python tests/benchmarks/all.py

Their tables, in Markdown, follow each other on one machine in one session.
"""

import subprocess
import sys
from pathlib import Path

BENCHMARKS = ("bench_job", "bench_readers", "bench_allan")


def main() -> None:
    """Run each in a process of its own; exit code 1 where one fails."""
    failed = []
    for name in BENCHMARKS:
        print(f"\n## {name}\n", flush=True)
        command = [sys.executable, "-m", f"tests.benchmarks.{name}"]
        root = Path(__file__).parents[2]
        if subprocess.run(command, cwd=root, check=False).returncode:  # noqa: S603 - our own scripts
            failed.append(name)
    if failed:
        sys.exit(f"{', '.join(failed)} failed; see above")


if __name__ == "__main__":
    main()

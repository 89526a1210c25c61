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
        command = [sys.executable, str(Path(__file__).with_name(f"{name}.py"))]
        if subprocess.run(command, check=False).returncode:  # noqa: S603 - the script beside this one
            failed.append(name)
    if failed:
        sys.exit(f"{', '.join(failed)} failed; see above")


if __name__ == "__main__":
    main()

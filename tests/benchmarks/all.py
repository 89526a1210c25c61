"""Run the benchmarks of time and memory in sequence: job, one axis, readers, Allan curve.

    python tests/benchmarks/all.py [--before TREE PYTHON] [--page docs/results/speed.md]

The tables in Markdown are from one machine and one session. `--before` also measures the job of another
version, given by a tree and its interpreter. `--page` replaces the tables of a page below its line
`<!-- measured -->`.
"""

import argparse
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np

#: Script -> heading.
BENCHMARKS = {
    "bench_job": "The whole job: 3 h at 200 Hz, six axes",
    "bench_axis": "One axis",
    "bench_readers": "Reading",
    "bench_allan": "The Allan curve",
}
#: Start of the measured part of a page.
_MARK = "<!-- measured -->\n"


def processor() -> str:
    """Return the name of the processor, if the machine provides it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def run(name: str, arguments: list[str]) -> tuple[str, int]:
    """Run a script of this folder and forward its output; return the output and the exit code."""
    root = Path(__file__).parents[2]
    surroundings = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")]),
    }
    command = [sys.executable, "-m", f"tests.benchmarks.{name}", *arguments]
    lines = []
    with subprocess.Popen(command, cwd=root, env=surroundings, stdout=subprocess.PIPE, text=True) as process:  # noqa: S603
        for line in process.stdout or ():
            print(line, end="", flush=True)
            lines.append(line)
    return "".join(lines), process.returncode


def main() -> None:
    """Run each benchmark in its own process; exit code 1 if one fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--before", nargs=2, metavar=("TREE", "PYTHON"))
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    versions = f"Python {platform.python_version()}, NumPy {np.__version__}"
    head = f"{processor()}, {os.cpu_count()} processors; {versions}.\n"
    print(head)
    parts, failed = [head], []
    for name, heading in BENCHMARKS.items():
        print(f"\n## {heading}\n", flush=True)
        before = ["--before", *given.before] if given.before and name == "bench_job" else []
        printed, code = run(name, before)
        parts.append(f"## {heading}\n\n{printed.strip()}\n")
        failed += [name] if code else []
    if failed:
        sys.exit(f"{', '.join(failed)} failed; see above")
    if given.page:
        above, mark, _ = given.page.read_text(encoding="utf-8").partition(_MARK)
        given.page.write_text(above + mark + "\n" + "\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()

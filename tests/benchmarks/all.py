"""Run the benchmarks of time and memory one after the other: job, one axis, readers, Allan curve.

    python tests/benchmarks/all.py [--before TREE PYTHON] [--page docs/results/speed.md]

Their tables, in Markdown, follow each other on one machine in one session. `--before` measures the whole job
of another version too, a tree and its interpreter; `--page` puts the tables into a page, below its line
`<!-- measured -->`, in the place of those that stand there.
"""

import argparse
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np

#: Script -> its heading.
BENCHMARKS = {
    "bench_job": "The whole job: 3 h at 200 Hz, six axes",
    "bench_axis": "One axis",
    "bench_readers": "Reading",
    "bench_allan": "The Allan curve",
}
#: Where the measured part of a page begins.
_MARK = "<!-- measured -->\n"


def processor() -> str:
    """Return the name of the processor, as far as the machine says it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def run(name: str, arguments: list[str]) -> tuple[str, int]:
    """Run a script of this folder, passing on what it prints; return that and its exit code."""
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
    """Run each in a process of its own; exit code 1 where one fails."""
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

"""CPU time of the stages of `imucal fit`, repeated work, memory, and y.

    python tests/benchmarks/bench_job.py [--hours 3] [--rate 200] [--log LOG] [--before TREE PYTHON]

The job runs with JSON only and with all pictures and the page; `--before` also runs it with another version,
given by a tree and its interpreter. The README's log is measured too. y is the CPU time of AllanTools'
``oadev``, 1e7 samples at 93 factors, in separate processes before and after the rest, because machines and
their load differ. Modules are compiled before, as by an installer. Stages that call each other overlap;
each includes the imports that it triggers.
"""

import argparse
import contextlib
import cProfile
import io
import json
import os
import pstats
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple, TypeVar

from imucal.resources import threads
from tests.benchmarks.process_memory import memory_of_family

_Number = TypeVar("_Number", int, float)

#: The log of the README's first command: 12 min at 50 Hz.
README_LOG = Path(__file__).parents[2] / "sample_logs" / "consumer_mems.mcap"
#: Job -> maximal CPU time, in y.
WANTED = {
    "JSON only": 0.6,
    "all pictures and the page": 1.0,
    "README's log, JSON only": 0.35,
    "README's log, all pictures and the page": 0.8,
}

#: Stage -> part of the file's path, and name of the measured function.
STAGES = {
    "imports, also within the others": ("<frozen importlib._bootstrap>", "_find_and_load"),
    "read": ("imucal/readers/__init__.py", "read"),
    "checksum of the log": ("imucal/readers/checksums.py", "_checked"),
    "screen": ("imucal/screening/__init__.py", "screen_values"),
    "Allan curve": ("imucal/allan/engine.py", "allan_curve"),
    "spectrum": ("imucal/allan/dct.py", "spectrum"),
    "spikes": ("imucal/fitting/robust.py", "clean"),
    "blocks of ordinates": ("imucal/fitting/spectral/blocks.py", "make_blocks"),
    "steps, cycles": ("imucal/fitting/spectral/disturbances/not_noise.py", "find_shapes"),
    "band and filter": ("imucal/fitting/spectral/disturbances/band_search.py", "find_band"),
    "choice of the model": ("imucal/fitting/spectral/selection.py", "choose"),
    "terms that are not in it": ("imucal/fitting/spectral/bounds.py", "hull_estimates"),
    "segments": ("imucal/fitting/spectral/disturbances/segments.py", "fit_segments"),
    "second opinion": ("imucal/fitting/cross_checks.py", "fit_of_curve"),
    "record length": ("imucal/planning.py", "resolution_findings"),
    "document and JSON": ("imucal/report/typed_json.py", "dumps"),
    "pictures and page": ("imucal/report/writer.py", "write_report"),
    "of these: transforms": ("imucal/allan/dct.py", "dct_ordinates"),
    "of these: blind starts": ("imucal/fitting/spectral/maximum.py", "find_starts"),
    "of these: likelihood": ("imucal/fitting/spectral/likelihood.py", "evaluate"),
}
#: Work that could be shared -> the function whose calls are counted.
REPEATS = {
    "transforms": ("imucal/allan/dct.py", "dct_ordinates"),
    "bins": ("imucal/fitting/spectral/blocks.py", "_binned"),
    "spike searches": ("imucal/fitting/robust.py", "find_spikes"),
    "covariances of a curve": ("imucal/fitting/moments/points.py", "_computed"),
    "likelihood evaluations": ("imucal/fitting/spectral/likelihood.py", "evaluate"),
}


_ALLANTOOLS = """
import time
import allantools
import numpy as np
samples = np.random.default_rng(0).standard_normal(10**7)
factors = np.unique(np.geomspace(1, 10**7 // 3, 106).round())[-93:]
start = time.process_time()
allantools.oadev(samples, rate=1.0, data_type="freq", taus=factors)
print(time.process_time() - start)
"""


def yardstick() -> float:
    """Return the CPU time of AllanTools' ``oadev`` in a separate process, in s."""
    done = subprocess.run([sys.executable, "-c", _ALLANTOOLS], check=True, capture_output=True, text=True)  # noqa: S603
    return float(done.stdout)


def simulate(folder: Path, hours: float, rate: float) -> Path:
    """Write a six-axis lz4 bag and return it."""
    log = folder / "job.bag"
    arguments = ["N=1e-4 + B=2e-5 + K=1e-6", "--accel", "N=1e-3 + B=2e-4 + K=1e-5"]
    arguments += ["--duration", f"{hours}h", "--rate", str(rate), "--seed", "7", "-q", "-o", str(log)]
    command = [sys.executable, "-m", "imucal", "simulate", *arguments]
    subprocess.run(command, check=True, capture_output=True)  # noqa: S603 - our own command
    return log


class Taken(NamedTuple):
    """CPU and wall time in s, and memory in MB."""

    cpu: float
    wall: float
    peak: float


def job(log: Path, folder: Path, *, pictures: bool) -> list[str]:
    """Return the arguments of the job."""
    return ["fit", str(log), "--json", "-q", *(["-o", str(folder)] if pictures else ["--no-report"])]


def measured(arguments: list[str], version: tuple[str, str]) -> tuple[float, float]:
    """Run the job of a version in a separate process; return CPU s and wall s."""
    start = time.perf_counter()
    process = _started(arguments, version)
    _, status, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        msg = f"imucal {' '.join(arguments)}: exit code {process.returncode}, expected 0"
        raise RuntimeError(msg)
    return used.ru_utime + used.ru_stime, wall


def peak(arguments: list[str], version: tuple[str, str]) -> float:
    """Return the peak memory of all processes of the job, in MB, sampled every 20 ms."""
    process = _started(arguments, version)
    most = 0
    while process.poll() is None:
        most = max(most, memory_of_family(process.pid)[0])
        time.sleep(0.02)
    return most / 1e6


def _started(arguments: list[str], version: tuple[str, str]) -> "subprocess.Popen[bytes]":
    tree, python = version
    command = [python, "-m", "imucal", *arguments]
    # The working folder must be the version's tree, because Python searches it first.
    return subprocess.Popen(  # noqa: S603 - our own command
        command, stdout=subprocess.DEVNULL, env=_surroundings(tree), cwd=tree
    )


@cache
def _compiled() -> tempfile.TemporaryDirectory[str]:
    """Return a temporary folder of compiled modules."""
    return tempfile.TemporaryDirectory()


def _surroundings(tree: str) -> dict[str, str]:
    """Return the environment of a run: its own tree, whose compiled modules are kept."""
    surroundings = {**os.environ, "PYTHONPATH": tree, "PYTHONPYCACHEPREFIX": _compiled().name}
    surroundings.pop("PYTHONDONTWRITEBYTECODE", None)
    return surroundings


def stages(arguments: list[str], tree: str) -> tuple[dict[tuple[str, str], float], float]:
    """Return the CPU time in s of every function of the job, by file and name, and the total."""
    script = str(Path(__file__).parent / "stage_times.py")
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "found.json"
        process = subprocess.Popen(  # noqa: S603 - our own command
            [sys.executable, script, str(found), *arguments, "--jobs", "1"],
            stdout=subprocess.DEVNULL,
            env={**_surroundings(tree), "IMUCAL_THREADS": "1"},
            cwd=tree,
        )
        _, _, used = os.wait4(process.pid, 0)
        every = json.loads(found.read_text(encoding="utf-8"))
    return {(path, name): seconds for path, name, seconds in every}, used.ru_utime + used.ru_stime


def repeats(arguments: list[str]) -> dict[tuple[str, str], int]:
    """Return the number of calls of every function of the job, by file and name."""
    from imucal.cli import main as imucal

    profile = cProfile.Profile()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        profile.runcall(imucal, [*arguments, "--jobs", "1"])
    calls: Counter[tuple[str, str]] = Counter()
    for (path, _, name), (_, count, _, _, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        calls[path, name] += count
    return calls


def _of(found: Mapping[tuple[str, str], _Number], where: tuple[str, str]) -> _Number | None:
    """Return the value of a function; None if it was not called."""
    file, function = where
    return next((n for (path, name), n in found.items() if path.endswith(file) and name == function), None)


def compared(jobs: Mapping[str, list[str]], versions: dict[str, tuple[str, str]]) -> dict[str, Taken]:
    """Return the cost of each job for each version, alternating: the best of three."""
    taken: dict[str, Taken] = {}
    for what, arguments in jobs.items():
        runs = {name: [measured(arguments, version)] for name, version in versions.items()}
        for _ in range(2):
            for name, version in versions.items():
                runs[name].append(measured(arguments, version))
        for name, found in runs.items():
            taken[f"{what} | {name}"] = Taken(*min(found), peak(arguments, versions[name]))
    return taken


def main() -> None:
    """Print the tables in Markdown."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--hours", type=float, default=3.0)
    parser.add_argument("--rate", type=float, default=200.0)
    parser.add_argument("--log", type=Path, help="a six-axis log; one is simulated otherwise")
    parser.add_argument("--before", nargs=2, metavar=("TREE", "PYTHON"), help="another version to measure")
    given = parser.parse_args()
    versions = {"before": tuple(given.before)} if given.before else {}
    versions["this"] = (str(Path(__file__).parents[2]), sys.executable)
    ys = [yardstick() for _ in range(2)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = given.log or simulate(folder, given.hours, given.rate)
        logs = {"": log, "README's log, ": README_LOG}
        jobs = {
            f"{whose}{what}": job(path, folder / "out", pictures=pictures)
            for whose, path in logs.items()
            for what, pictures in (("JSON only", False), ("all pictures and the page", True))
        }
        taken = compared(jobs, versions)
        asked = job(log, folder / "out", pictures=True)
        tree = versions["this"][0]
        stages(asked, tree)  # the first run compiles modules
        runs = [stages(asked, tree) for _ in range(3)]
        found, total = min(runs, key=lambda run: run[1])
        calls = repeats(asked)
    ys += [yardstick() for _ in range(2)]
    y = min(ys)
    print(f"{log.name}; y = {y:.2f} s ({', '.join(f'{each:.2f}' for each in ys)}: two before, two after)")
    print(f"{threads()} processors\n")
    print(
        "| job | version | CPU s | CPU / y | wall s | wall / CPU | peak MB |\n|---|---|---|---|---|---|---|"
    )
    for what, each in taken.items():
        numbers = f"{each.cpu / y:.2f} | {each.wall:.2f} | {each.wall / each.cpu:.2f} | {each.peak:.0f}"
        print(f"| {what} | {each.cpu:.2f} | {numbers} |")
    print("\n| what | wanted | measured | met |\n|---|---|---|---|")
    for what, most in WANTED.items():
        least = taken[f"{what} | this"].cpu / y
        print(f"| {what}, CPU / y | ≤ {most} | {least:.2f} | {'yes' if least <= most else 'no'} |")
    print(f"\n| stage of {total:.2f} s, one thread | CPU s | CPU / y | of all, % |\n|---|---|---|---|")
    for stage, where in STAGES.items():
        seconds = _of(found, where) or 0.0
        print(f"| {stage} | {seconds:.2f} | {seconds / y:.3f} | {100 * seconds / total:.0f} |")
    print("\n| work that could be shared | times |\n|---|---|")
    for work, where in REPEATS.items():
        print(f"| {work} | {_of(calls, where) or 0} |")


if __name__ == "__main__":
    main()

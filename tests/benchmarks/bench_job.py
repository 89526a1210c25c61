"""Where the time of `imucal fit` goes: CPU of each stage, repeats of the same work, memory, and y.

    python tests/benchmarks/bench_job.py [--hours 3] [--rate 200] [--log LOG] [--before TREE PYTHON]

The job is done with the JSON only and with all pictures and the page; `--before` does it also with
another version, a tree and the interpreter that has what it needs. y is the CPU time of AllanTools'
``oadev``, 1e7 samples at 93 factors, in the same run: machines differ, and so do their hours. Stages
overlap where one calls another; each is counted whole.
"""

import argparse
import contextlib
import cProfile
import io
import os
import pstats
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from imucal.resources import threads

#: Stage -> part of the file's path, and name of the function whose CPU it is.
STAGES = {
    "import and command line": ("<frozen importlib._bootstrap>", "_find_and_load"),
    "read": ("imucal/readers/__init__.py", "read"),
    "screen": ("imucal/screening/__init__.py", "screen"),
    "Allan curve": ("imucal/allan/engine.py", "allan_curve"),
    "spikes": ("imucal/fitting/robust.py", "clean"),
    "blocks of ordinates": ("imucal/fitting/spectral/blocks.py", "make_blocks"),
    "blind starts": ("imucal/fitting/spectral/starts.py", "find_starts"),
    "likelihood": ("imucal/fitting/spectral/likelihood.py", "evaluate"),
    "segments": ("imucal/fitting/spectral/segment_fit.py", "fit_segments"),
    "second opinion": ("imucal/fitting/curve_opinion.py", "fit_of_curve"),
    "record length": ("imucal/planning.py", "resolution_findings"),
    "spectrum": ("imucal/allan/dct.py", "spectrum"),
    "pictures and page": ("imucal/report/writer.py", "write_report"),
}
#: Work that could be shared -> the functions of which the calls are counted.
REPEATS = {
    "transforms": ("imucal/allan/dct.py", "_transform"),
    "bins": ("imucal/fitting/spectral/transform.py", "_bin"),
    "spike searches": ("imucal/fitting/robust.py", "find_spikes"),
    "covariances of a curve": ("imucal/fitting/moments/av_covariance.py", "_computed"),
    "likelihood evaluations": ("imucal/fitting/spectral/likelihood.py", "evaluate"),
}


def yardstick() -> float:
    """Return the CPU time of AllanTools' ``oadev``, in s."""
    import allantools

    samples = np.random.default_rng(0).standard_normal(10**7)
    factors = np.unique(np.geomspace(1, 10**7 // 3, 106).round())[-93:]
    start = time.process_time()
    allantools.oadev(samples, rate=1.0, data_type="freq", taus=factors)
    return time.process_time() - start


def simulate(folder: Path, hours: float, rate: float) -> Path:
    """Write a six-axis lz4 bag and return it."""
    log = folder / "job.bag"
    arguments = ["N=1e-4 + B=2e-5 + K=1e-6", "--accel", "N=1e-3 + B=2e-4 + K=1e-5"]
    arguments += ["--duration", f"{hours}h", "--rate", str(rate), "--seed", "7", "-q", "-o", str(log)]
    command = [sys.executable, "-m", "imucal", "simulate", *arguments]
    subprocess.run(command, check=True, capture_output=True)  # noqa: S603 - our own command
    return log


def job(log: Path, folder: Path, *, pictures: bool) -> list[str]:
    """Return the arguments of the job."""
    return ["fit", str(log), "--json", "-q", *(["-o", str(folder)] if pictures else ["--no-report"])]


def measured(arguments: list[str], version: tuple[str, str]) -> tuple[float, float, float]:
    """Run the job of a version in a process of its own; return CPU s, wall s, and peak in MB."""
    tree, python = version
    start = time.perf_counter()
    command = [python, "-m", "imucal", *arguments]
    surroundings = {**os.environ, "PYTHONPATH": tree}
    # In its own folder: Python looks where it was started first, and would find this version there.
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=surroundings, cwd=tree)  # noqa: S603
    _, status, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        msg = f"imucal {' '.join(arguments)}: exit code {process.returncode}, expected 0"
        raise RuntimeError(msg)
    return used.ru_utime + used.ru_stime, wall, used.ru_maxrss / 1024


def _run(arguments: list[str]) -> None:
    from imucal.cli import main as imucal

    imucal(arguments)


def stages(arguments: list[str]) -> dict[tuple[str, str], tuple[int, float]]:
    """Return calls and CPU time in s of every function of the job, by file and name."""
    profile = cProfile.Profile(time.process_time)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        profile.runcall(_run, arguments)
    found: dict[tuple[str, str], tuple[int, float]] = {}
    for (path, _, name), (_, calls, _, total, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        before = found.get((path, name), (0, 0.0))
        found[path, name] = (before[0] + calls, max(before[1], total))
    return found


def _of(found: dict[tuple[str, str], tuple[int, float]], where: tuple[str, str]) -> tuple[int, float]:
    """Return calls and CPU of a function; 0 of one that was not called."""
    file, function = where
    return next(
        (entry for (path, name), entry in found.items() if path.endswith(file) and name == function), (0, 0.0)
    )


def compared(log: Path, folder: Path, versions: dict[str, tuple[str, str]], y: float) -> None:
    """Print what the job takes, of each version in turn; the best of three."""
    print("| job | version | CPU s | CPU / y | wall / CPU | peak MB |\n|---|---|---|---|---|---|")
    for what, pictures in (("JSON only", False), ("all pictures and the page", True)):
        arguments = job(log, folder, pictures=pictures)
        runs = {name: [measured(arguments, version)] for name, version in versions.items()}
        for _ in range(2):
            for name, version in versions.items():
                runs[name].append(measured(arguments, version))
        for name, found in runs.items():
            cpu, wall, peak = min(found)
            print(
                f"| {what} | {name} | {cpu:.2f} | {cpu / y:.2f} | {wall / cpu:.2f} | {peak:.0f} |", flush=True
            )


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
    y = min(yardstick() for _ in range(3))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = given.log or simulate(folder, given.hours, given.rate)
        print(f"{log.name}, y = {y:.2f} s, {threads()} processors\n")
        compared(log, folder / "out", versions, y)
        # The profiler sees one thread.
        found = stages([*job(log, folder / "out", pictures=True), "--jobs", "1"])
    print("\n| stage, under the profiler | calls | CPU s | CPU / y | of all, % |\n|---|---|---|---|---|")
    total = max(seconds for _, seconds in found.values())
    for stage, where in STAGES.items():
        calls, seconds = _of(found, where)
        print(f"| {stage} | {calls} | {seconds:.2f} | {seconds / y:.2f} | {100 * seconds / total:.0f} |")
    print("\n| work that could be shared | times |\n|---|---|")
    for work, where in REPEATS.items():
        print(f"| {work} | {_of(found, where)[0]} |")


if __name__ == "__main__":
    main()

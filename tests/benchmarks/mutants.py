"""Mutation test: change random lines in a copy of the tree and run the tests.

First, the complete suite runs once in the copy, and `coverage` records the lines of each test. Then each
mutant meets all tests that may detect it, in the order of `mutant_tests`, until one fails; a survivor has
met all of these tests. A mutant that hangs or cannot be imported is caught. Times are CPU times, so that a
busy machine does not look like a hang. `mutation_points` lists the excluded code. The record of the suite
is reused until a file changes.

Tests with the marker `slow` run last, so that the result shows the mutants that the default tests miss.

Run as ``python -m tests.benchmarks.mutants [--n 100] [--seed 1] [--rooms allan fitting] [--timeout 60]``.
"""

import argparse
import contextlib
import difflib
import hashlib
import json
import math
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue

from coverage import CoverageData

from tests.benchmarks.mutant_tests import Suite
from tests.benchmarks.mutation_points import Mutation, changes_nothing, mutated, mutations

ROOT = Path(__file__).parents[2]
ROOMS = ("readers", "allan", "fitting", "checking", "report")
#: Files and folders that the tests need.
_COPIED = ("imucal", "tests", "sample_logs", "docs", "README.md", "CONTRIBUTING.md", "CHANGELOG.md")
_COPIED_TOO = ("pyproject.toml", "mkdocs.yml", "LICENSE")
#: Recorded seconds of tests in the first rounds of a mutant; the last round has all others.
_ROUNDS = (8.0, 60.0)
#: A waiting process takes no CPU time, so this multiple of the limit, in wall time, is a hang.
_PATIENCE = 6
_OPTIONS = ("-q", "-p", "tests.benchmarks.mutant_plugin", "-p", "no:cacheprovider", "--tb=no", "--no-header")
#: Without the project's options: one process, and the first failure is enough.
_ALONE = ("-o", "addopts=--import-mode=importlib", "-p", "no:xdist", "-x")
#: Exit codes of pytest for a survivor: all tests passed, or there was no test.
_SURVIVED = frozenset({0, 5})


#: Suffix of the name of a slow test.
_SLOW = " (slow)"
#: Output of pytest for the last mutant of a tree.
_OUTPUT = "said.txt"


def main() -> None:
    """Print the outcome of each mutant, the survivors' differences, and the share that was caught."""
    options = _options()
    with tempfile.TemporaryDirectory(prefix="imucal-mutants-") as folder:
        copies: Queue[Path] = Queue()
        for number in range(options.jobs):
            copies.put(_copy(Path(folder) / f"tree{number}"))
        suite = _recorded(Path(folder), options.tests)
        chosen = _chosen(options.rooms, options.n, options.seed)

        def fate(job: tuple[str, Mutation]) -> tuple[bool, str]:
            copy = copies.get()
            try:
                return _fate(copy, suite, *job, timeout=options.timeout, most=options.most)
            finally:
                copies.put(copy)

        caught = late = 0
        with ThreadPoolExecutor(options.jobs) as pool:
            for number, (job, (noticed, text)) in enumerate(
                zip(chosen, pool.map(fate, chosen), strict=True), start=1
            ):
                caught += noticed
                late += noticed and text.endswith(_SLOW)
                print(f"[{number}/{len(chosen)}] {'caught' if noticed else 'SURVIVED'} {text}")
                if not noticed:
                    print("".join(_difference(*job)))
                sys.stdout.flush()
    share = 100 * caught / max(len(chosen), 1)
    print(f"caught {caught} of {len(chosen)} ({share:.0f} %), {late} by slow tests only")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--n", type=int, default=100, help="number of mutants")
    parser.add_argument("--seed", type=int, default=1, help="chooses them")
    parser.add_argument("--rooms", nargs="+", default=ROOMS, help="folders of the package")
    parser.add_argument(
        "--tests", nargs="+", default=["tests"], help="those that may notice, for a quick look"
    )
    parser.add_argument("--timeout", type=float, default=60.0, help="seconds beyond what tests take")
    parser.add_argument("--most", type=float, default=math.inf, help="seconds of tests that a mutant meets")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time")
    return parser.parse_args()


def _chosen(rooms: Iterable[str], n: int, seed: int) -> list[tuple[str, Mutation]]:
    """Draw lines uniformly from the mutable lines of the folders, and one change of each."""
    places: dict[tuple[str, int], list[Mutation]] = {}
    sources: dict[str, bytes] = {}
    for room in rooms:
        for file in sorted((ROOT / "imucal" / room).rglob("*.py")):
            path = file.relative_to(ROOT).as_posix()
            sources[path] = file.read_bytes()
            for mutation in mutations(sources[path], file.stem):
                places.setdefault((path, mutation.line), []).append(mutation)
    rng = random.Random(seed)  # noqa: S311 - a draw, no secret
    chosen: list[tuple[str, Mutation]] = []
    for path, line in rng.sample(sorted(places), len(places)):
        mutation = rng.choice(places[path, line])
        if len(chosen) < n and not changes_nothing(sources[path], mutation):
            chosen.append((path, mutation))
    return chosen


def _copy(place: Path) -> Path:
    """Copy the tree and compile it, so that only a mutant is compiled again."""
    place.mkdir()
    for name in (*_COPIED, *_COPIED_TOO):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, place / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, place)
    subprocess.run([sys.executable, "-m", "compileall", "-q", "imucal"], cwd=place, check=True)
    return place


def _recorded(folder: Path, chosen: list[str]) -> Suite:
    """Return the recorded suite, from an earlier run if no file has changed."""
    digest = hashlib.sha256("\n".join(chosen).encode())
    for file in sorted(p for name in ("imucal", "tests") for p in (ROOT / name).rglob("*") if p.is_file()):
        if "__pycache__" not in file.parts:
            digest.update(file.relative_to(ROOT).as_posix().encode() + file.read_bytes())
    kept = Path(tempfile.gettempdir()) / f"imucal-lines-{digest.hexdigest()[:16]}.json"
    if not kept.exists():
        print("running the suite once, to see which test runs which line ...", flush=True)
        suite = _record(folder, chosen)
        record = {"lines": suite.lines, "seconds": suite.seconds, "slow": sorted(suite.slow)}
        kept.write_text(json.dumps(record), encoding="utf-8")
    found = json.loads(kept.read_text(encoding="utf-8"))
    return Suite(root=ROOT, lines=found["lines"], seconds=found["seconds"], slow=frozenset(found["slow"]))


def _record(folder: Path, chosen: list[str]) -> Suite:
    tree, lines = _copy(folder / "recorded"), folder / "lines"
    lines.mkdir()
    environment = {**_environment(tree), "IMUCAL_LINES": str(lines)}
    command = [
        sys.executable,
        "-m",
        "pytest",
        *_OPTIONS,
        "-m",
        "",
        f"--basetemp={folder / 'pytest'}",
        *chosen,
    ]
    ended = subprocess.run(command, cwd=tree, env=environment, check=False, stdout=subprocess.DEVNULL)  # noqa: S603
    if ended.returncode not in {0, 1}:
        raise SystemExit(f"the suite did not run: pytest ended with {ended.returncode}")
    seconds: dict[str, float] = {}
    failed: set[str] = set()
    slow: set[str] = set()
    for seen in lines.glob("*.json"):
        found = json.loads(seen.read_text(encoding="utf-8"))
        seconds |= found["seconds"]
        failed |= set(found["failed"])
        slow |= set(found["slow"])
    if failed:
        print(f"{len(failed)} tests fail without a mutant and are left out:", *sorted(failed), sep="\n  ")
    tests: dict[str, dict[str, list[str]]] = {}
    for file in lines.glob("*.coverage"):
        data = CoverageData(str(file))
        data.read()
        for measured in data.measured_files():
            here = tests.setdefault(Path(measured).relative_to(tree).as_posix(), {})
            for line, names in data.contexts_by_lineno(measured).items():
                here.setdefault(str(line), []).extend(name for name in names if name and name not in failed)
    return Suite(root=ROOT, lines=tests, seconds=seconds, slow=frozenset(slow))


def _environment(tree: Path, seconds: float = math.inf) -> dict[str, str]:
    data = os.environ.get("IMUCAL_REAL_DATA", str(ROOT.parent / "shared" / "data"))
    return {
        **os.environ,
        "PYTHONPATH": str(tree),
        # Two versions of a file with equal size and second would share their compiled file.
        "PYTHONDONTWRITEBYTECODE": "1",
        "IMUCAL_REAL_DATA": data,
        **({"IMUCAL_SECONDS": str(math.ceil(seconds))} if math.isfinite(seconds) else {}),
    }


def _fate(
    tree: Path, suite: Suite, path: str, mutation: Mutation, *, timeout: float, most: float
) -> tuple[bool, str]:
    """Apply a mutation, run its tests in rounds and restore the file; return whether one failed, and why."""
    tests, met = suite.tests_of(path, mutation)
    began = time.monotonic()
    how = "no test runs the line" if not met else "all passed"
    with _broken(tree, path, mutation):
        noticed = False
        default, slow = ([test for test in tests if (test in suite.slow) is late] for late in (False, True))
        for part in (*_rounds(default, suite.seconds, most), *_rounds(slow, suite.seconds, most)):
            ended = _run(tree, part, timeout=timeout + 3 * sum(suite.seconds[test] for test in part))
            noticed = ended not in _SURVIVED
            if noticed:
                how = "hung" if ended is None else _failure(tree)
                how += _SLOW if part[0] in suite.slow else ""
                break
    old = (ROOT / path).read_bytes()[mutation.start : mutation.stop].decode()
    change = f"{old!r} -> {mutation.new!r}"
    return noticed, f"{path}:{mutation.line} {change} {time.monotonic() - began:.0f} s {how}".rstrip()


def _rounds(tests: list[str], seconds: dict[str, float], most: float) -> Iterator[list[str]]:
    """Split tests into rounds: a few seconds for near tests, and longer for others."""
    rest = list(tests)
    for limit in (*_ROUNDS, most):
        part: list[str] = []
        spent = 0.0
        while rest and spent < limit:
            spent += seconds[rest[0]]
            part.append(rest.pop(0))
        if part:
            yield part


@contextlib.contextmanager
def _broken(tree: Path, path: str, mutation: Mutation) -> Iterator[None]:
    file = tree / path
    source = file.read_bytes()
    for compiled in (file.parent / "__pycache__").glob(f"{file.stem}.*.pyc"):
        compiled.unlink()
    file.write_bytes(mutated(source, mutation))
    try:
        yield
    finally:
        file.write_bytes(source)


def _run(tree: Path, tests: list[str], *, timeout: float) -> int | None:
    """Run tests until one fails; return pytest's exit code, or None if they hung."""
    arguments = tree / "arguments.txt"
    arguments.write_text("\n".join(tests), encoding="utf-8")
    place = f"--basetemp={tree.parent / (tree.name + '-pytest')}"
    command = [sys.executable, "-m", "pytest", *_OPTIONS, *_ALONE, place, f"@{arguments}"]
    with (tree / _OUTPUT).open("wb") as output:
        process = subprocess.Popen(  # noqa: S603 - our own tests
            command,
            cwd=tree,
            env=_environment(tree, timeout),
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        ended = process.wait(_PATIENCE * timeout)
    except subprocess.TimeoutExpired:
        return None
    else:
        return None if ended == -signal.SIGXCPU else ended
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _failure(tree: Path) -> str:
    """Return the test that detected the last mutant, or that no test could start."""
    output = (tree / _OUTPUT).read_text(encoding="utf-8", errors="replace")
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    return found[1] if found else "the tests can not begin"


def _difference(path: str, mutation: Mutation) -> Iterator[str]:
    source = (ROOT / path).read_bytes()
    old, new = (text.decode().splitlines(keepends=True) for text in (source, mutated(source, mutation)))
    return difflib.unified_diff(old, new, path, path, n=2)


if __name__ == "__main__":
    main()

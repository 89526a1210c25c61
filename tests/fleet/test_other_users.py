"""Tests of protection against other users: they cannot submit tasks, read answers or plant modules.

As root, the tests act as another user; otherwise they check the conditions that such a user would need.
"""

import importlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from imucal.child_process import ChildProcess
from tests.fleet.faults import Bench, ended, stopped_log
from tests.fleet.simulated_fleet import make_fleet

NOBODY = 65534
IS_ROOT = hasattr(os, "getuid") and os.getuid() == 0

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks the system of Linux")


@pytest.fixture
def shared() -> Iterator[Path]:
    """Yield a folder that all users may write to, outside of pytest's private folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o777)
        yield folder


def as_nobody(*command: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command as another user, or as this user if the tests do not run as root."""
    user: dict[str, Any] = {"user": NOBODY, "group": NOBODY, "extra_groups": []} if IS_ROOT else {}
    done: subprocess.CompletedProcess[str] = subprocess.run(  # noqa: S603 - the commands of these tests
        command, cwd=cwd, capture_output=True, text=True, check=False, **user
    )
    return done


@pytest.mark.slow
def test_a_run_opens_no_port_and_no_pipe_to_others(tmp_path: Path) -> None:
    """None of its processes has a socket, and other users cannot write to their pipes."""
    bench = Bench(tmp_path.resolve())
    make_fleet(bench.folder / "logs", logs=3, seconds=10.0, seed=81)
    try:
        run = bench.start("store", "--jobs", "2")
        fork = stopped_log(run.pid)
        tree = [psutil.Process(run.pid), *psutil.Process(run.pid).children(), fork]
        assert len(tree) == 4
        assert [process.net_connections(kind="all") for process in tree] == [[]] * len(tree)
        if IS_ROOT:
            for child in tree[1:]:
                tried = as_nobody("/bin/sh", "-c", f"echo task > /proc/{child.pid}/fd/0", cwd=Path("/"))
                assert "ermission denied" in tried.stderr
        fork.resume()
        assert ended(run).code == 0
    finally:
        bench.end_runs()


def test_a_run_loads_no_module_that_others_planted(tmp_path: Path, shared: Path) -> None:
    """The run starts in a folder that all users may write to; children also load their own packages."""
    make_fleet(tmp_path / "logs", logs=1, seconds=10.0, seed=82, axes=1)
    mark = shared / "was-run"
    for name in ("zlib_ng.py", "numpy.py", "sitecustomize.py"):
        as_nobody("/bin/sh", "-c", f'echo \'open("{mark}", "w")\' > {name}', cwd=shared)
    assert (shared / "numpy.py").exists()
    command = [sys.executable, "-P", "-m", "imucal", "fleet", "run", str(tmp_path / "logs")]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    arguments = ["-o", str(tmp_path / "store"), "--jobs", "2", "--max-failed", "100%"]
    done = subprocess.run(  # noqa: S603 - our own interpreter
        [*command, *arguments], cwd=shared, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not mark.exists()


@pytest.mark.parametrize("scratch", ["open", "of another's in one for all"])
def test_a_child_does_not_import_from_scratch_folders(
    scratch: str, shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask adds such a folder to its workers' path; a private folder stays in the path."""
    if scratch != "open" and not IS_ROOT:
        pytest.skip("nobody else is at hand")
    folder = shared
    if scratch != "open":
        shared.chmod(0o1777)
        as_nobody("/bin/mkdir", "-m", "755", "worker", cwd=shared)
        folder = shared / "worker"
    (folder / "planted_module.py").write_text("")
    (tmp_path / "own_module.py").write_text("")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.syspath_prepend(tmp_path)
    child = ChildProcess()
    planted, own = (
        child.ask(importlib.import_module, name, seconds=60, memory=8 << 30)
        for name in ("planted_module", "own_module")
    )
    child.end()
    assert planted.words == "ModuleNotFoundError: No module named 'planted_module'"
    # The module was imported, but modules cannot be pickled.
    assert own.words.startswith("TypeError: cannot pickle 'module' object")

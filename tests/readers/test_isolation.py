"""Parsers in a child process: they answer or are stopped, and can't damage the caller."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal import child_process
from imucal.errors import ReadError
from imucal.readers import isolation, read
from imucal.readers.isolation import isolated
from tests.raising import raises
from tests.readers.ulog.test_ulog import two_sensors


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "log.bin"
    path.write_bytes(b"12345")
    return path


def call(file: Path, function: Callable[..., Any], *args: Any) -> Any:  # noqa: ANN401 - whatever is called
    return isolated(file, function, "test")(*args)


def test_a_child_returns_the_result_of_the_function(file: Path) -> None:
    """Arrays can have any size, and all calls use one child."""
    assert call(file, len, b"abc") == 3
    np.testing.assert_array_equal(call(file, np.arange, 3_000_000), np.arange(3_000_000))
    child = call(file, os.getpid)
    assert child != os.getpid()
    assert call(file, os.getpid) == child


def test_an_exception_in_the_child_is_a_read_error(file: Path) -> None:
    """The error contains the file, the format and a reason of one line. The child keeps running."""
    child = call(file, os.getpid)
    with pytest.raises(ReadError) as caught:
        call(file, int, "no\nnumber")
    assert str(caught.value) == (
        f"{file}: not a readable test file: ValueError: invalid literal for int() with base 10: 'no\\nnumber'"
    )
    with raises(ReadError, "SystemExit: 3", place="log.bin"):
        call(file, sys.exit, 3)
    assert call(file, os.getpid) == child


def test_an_endless_call_is_stopped(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time limit depends on the file's size. The next call starts a new child."""
    monkeypatch.setattr(isolation, "PATIENCE", 0.5)
    child = call(file, os.getpid)
    with raises(ReadError, "takes more than", place="log.bin"):
        call(file, time.sleep, 60)
    monkeypatch.undo()
    assert not _runs(child)
    assert call(file, len, b"ab") == 2


def test_a_crash_of_the_child_is_a_read_error(file: Path) -> None:
    """A failed allocation in polars, for example, ends the process."""
    with raises(ReadError, "crashes", place="log.bin"):
        call(file, os.abort)
    assert call(file, len, b"ab") == 2


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of memory")
def test_the_memory_of_the_child_is_limited(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file can declare any size."""
    monkeypatch.setattr(isolation, "memory_limit", lambda: 1_000_000)
    with raises(ReadError, "needs too much memory", place="log.bin"):
        call(file, bytes, 1 << 36)


def test_prints_in_the_child_are_discarded(file: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Prints must not mix with the results or appear in the caller's streams."""
    call(file, os.system, "echo printed; echo said >&2")
    call(file, print, "printed")
    assert call(file, len, b"ab") == 2
    assert capfd.readouterr() == ("", "")


def test_an_interrupted_call_leaves_no_result_behind(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next call gets its own result."""
    assert call(file, len, b"abc") == 3

    def interrupted(stream: object) -> bytes:
        del stream
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(child_process, "_receive", interrupted)
        with pytest.raises(KeyboardInterrupt):
            call(file, len, b"abcd")
    assert call(file, len, b"ab") == 2


def test_the_child_ends_with_its_parent(file: Path) -> None:
    """The child ends even if the parent is killed."""
    script = (
        "import os, pathlib, signal, sys; from imucal.readers.isolation import isolated\n"
        "print(isolated(pathlib.Path(sys.argv[1]), os.getpid, 'test')(), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run(  # noqa: S603 - this very interpreter
        [sys.executable, "-c", script, str(file)], capture_output=True, text=True, check=False
    )
    assert done.returncode == -signal.SIGKILL
    child = int(done.stdout)
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline and _runs(child):
        time.sleep(0.05)
    assert not _runs(child)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    # A zombie process has ended but still exists.
    status = Path(f"/proc/{process}/stat")
    return not status.exists() or status.read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"


def test_a_ulog_that_hangs_pyulog_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The definitions are full of zeros, so pyulog seeks back at the end of the file forever."""
    path = two_sensors(tmp_path / "flight.ulg")
    data = bytearray(path.read_bytes())
    data[296:596] = bytes(300)
    path.write_bytes(data)
    monkeypatch.setattr(isolation, "PATIENCE", 2.0)
    with raises(ReadError, "takes more than", place="flight.ulg"):
        read(path)

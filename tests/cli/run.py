"""The command line as a script meets it: two streams and an exit code."""

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

import pytest

from imucal.cli import main

__all__ = ["SAMPLE_LOGS", "run", "run_process"]

SAMPLE_LOGS = Path(__file__).parents[2] / "sample_logs"


def run(
    *arguments: str, cwd: Path, text: str | bytes | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run ``imucal ARGUMENTS`` in `cwd`, with `text` on standard input, in this process.

    A new process would import everything again, which takes longer than most commands. Tests of the
    interpreter's behaviour (encoding of a terminal, closed streams, signals) use `run_process`.
    """
    data = text.encode() if isinstance(text, str) else text or b""
    given, out, err = io.BytesIO(data), io.BytesIO(), io.BytesIO()
    talk = [io.TextIOWrapper(stream, encoding="utf-8") for stream in (given, out, err)]
    with (
        contextlib.chdir(cwd),
        mock.patch.dict(os.environ, environment),
        mock.patch("sys.stdin", talk[0]),
        mock.patch("sys.stdout", talk[1]),
        mock.patch("sys.stderr", talk[2]),
        pytest.raises(SystemExit) as ended,
    ):
        main(arguments)
    talk[1].flush()
    talk[2].flush()
    code = ended.value.code
    assert code is None or isinstance(code, int)
    return subprocess.CompletedProcess(arguments, code or 0, out.getvalue().decode(), err.getvalue().decode())


def run_process(
    *arguments: str, cwd: Path, text: str | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run ``imucal ARGUMENTS`` in `cwd`, with `text` on standard input."""
    return subprocess.run(  # noqa: S603 - our own command
        [sys.executable, "-m", "imucal", *arguments],
        cwd=cwd,
        env={**os.environ, **environment},
        input=text,
        capture_output=True,
        encoding="utf-8",
        check=False,
        timeout=120,
    )

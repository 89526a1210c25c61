"""The command line as a script meets it: a process with its two streams and its exit code."""

import os
import subprocess
import sys
from pathlib import Path

__all__ = ["SAMPLE_LOGS", "run"]

SAMPLE_LOGS = Path(__file__).parents[2] / "sample_logs"


def run(
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

"""The fenced code blocks of a Markdown page, run as a reader would run them."""

import os
import re
import subprocess
import sys
from pathlib import Path

__all__ = ["code_blocks", "run_block"]

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def code_blocks(page: Path) -> list[tuple[str, str]]:
    """Return the language and text of every fenced block, in order."""
    return _FENCE.findall(page.read_text(encoding="utf-8"))


def run_block(language: str, text: str, folder: Path) -> None:
    """Run a python block, the `imucal` lines of a console block, or save a toml block, in `folder`.

    Other lines of a console block (``pip install …``) are not run here.
    """
    if language == "python":
        _run([sys.executable, "-c", text], folder)
    elif language == "console":
        for line in re.sub(r"\\\n\s*", " ", text).splitlines():
            if line.startswith("imucal "):
                _run(["bash", "-euo", "pipefail", "-c", line], folder)
    elif language == "toml":
        (folder / "limits.toml").write_text(text, encoding="utf-8")


def _run(command: list[str], folder: Path) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "MPLBACKEND": "Agg"}
    done = subprocess.run(  # noqa: S603 - commands of our own pages
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"

"""The fenced code blocks of a Markdown page, run as a reader would run them."""

import contextlib
import re
import shlex
import shutil
from pathlib import Path

from tests.cli.run import run

__all__ = ["Kept", "code_blocks", "run_block"]

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def code_blocks(page: Path) -> list[tuple[str, str]]:
    """Return the language and text of every fenced block, in order."""
    return _FENCE.findall(page.read_text(encoding="utf-8"))


class Kept:
    """A command that is run once; when it stands in another page, its folder is copied from then."""

    def __init__(self, line: str, name: str) -> None:
        self._line = line
        self._name = name
        self._made: Path | None = None

    def brought(self, line: str, folder: Path) -> bool:
        """Copy what the command made into `folder`; False if it is another one, or the first time."""
        if line != self._line:
            return False
        if self._made is None:
            self._made = folder / self._name
            return False
        shutil.copytree(self._made, folder / self._name)
        return True


def run_block(language: str, text: str, folder: Path, *, kept: Kept | None = None) -> None:
    """Run a python block, the `imucal` lines of a console block, or save a toml block, in `folder`.

    Other lines of a console block (``pip install …``) are not run here, and not what was `kept`.
    """
    if language == "python":
        with contextlib.chdir(folder):
            exec(compile(text, "the block", "exec"), {"__name__": "__main__"})  # noqa: S102 - our own pages
    elif language == "console":
        for line in re.sub(r"\\\n\s*", " ", text).splitlines():
            if line.startswith("imucal ") and not (kept and kept.brought(line, folder)):
                _run(line, folder)
    elif language == "toml":
        (folder / "limits.toml").write_text(text, encoding="utf-8")


def _run(line: str, folder: Path) -> None:
    """Run a command line, whose output may go to a file."""
    _, *words = shlex.split(line, comments=True)
    words, target = (words[:-2], words[-1]) if ">" in words else (words, None)
    done = run(*words, cwd=folder)
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    if target is not None:
        (folder / target).write_text(done.stdout, encoding="utf-8")

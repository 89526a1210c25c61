"""The fenced code blocks of a Markdown page, run as a reader would run them."""

import contextlib
import math
import re
import shlex
import shutil
from pathlib import Path

from tests.cli.run import run

__all__ = ["Kept", "code_blocks", "missing_lines", "run_block"]

#: A number within a word: not the 3 of accel3, nor the 2 of s^2.
_NUMBER = re.compile(r"(?<![\w^.])\d+(?:\.\d+)?(?:e[+-]?\d+)?")
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


def run_block(language: str, text: str, folder: Path, *, kept: Kept | None = None) -> str:
    """Run a python block, the `imucal` lines of a console block, or save a toml block; return what was said.

    Other lines of a console block (``pip install …``) are not run here, and not what was `kept`.
    """
    if language == "python":
        with contextlib.chdir(folder):
            exec(compile(text, "the block", "exec"), {"__name__": "__main__"})  # noqa: S102 - our own pages
    elif language == "console":
        said = ""
        for line in re.sub(r"\\\n\s*", " ", text).splitlines():
            if line.startswith("imucal ") and not (kept and kept.brought(line, folder)):
                said += _run(line, folder)
        return said
    elif language == "toml":
        (folder / "limits.toml").write_text(text, encoding="utf-8")
    return ""


def missing_lines(shown: str, said: str) -> list[str]:
    """Return the lines of a block that a run did not print, however they are wrapped.

    Numbers may differ by a tenth, as between versions; words may not.
    """
    words = [_value(word) for word in said.split()]
    return [line for line in shown.splitlines() if line.strip() and not _stands_in(line.split(), words)]


def _stands_in(line: list[str], words: list[tuple[str, tuple[float, ...]]]) -> bool:
    wanted = [_value(word) for word in line]
    return any(
        all(map(_alike, wanted, words[start : start + len(wanted)]))
        for start in range(len(words) - len(wanted) + 1)
    )


def _value(word: str) -> tuple[str, tuple[float, ...]]:
    """Return a word without its numbers, and those."""
    return _NUMBER.sub("#", word), tuple(map(float, _NUMBER.findall(word)))


def _alike(one: tuple[str, tuple[float, ...]], other: tuple[str, tuple[float, ...]]) -> bool:
    near = all(math.isclose(a, b, rel_tol=0.1) for a, b in zip(one[1], other[1], strict=False))
    return one[0] == other[0] and near


def _run(line: str, folder: Path) -> str:
    """Run a command line, whose output may go to a file; return what it printed."""
    _, *words = shlex.split(line, comments=True)
    words, target = (words[:-2], words[-1]) if ">" in words else (words, None)
    done = run(*words, cwd=folder)
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    if target is not None:
        (folder / target).write_text(done.stdout, encoding="utf-8")
    return done.stdout + done.stderr

"""Fenced code blocks of Markdown pages: they are run in order and compared with the output."""

import contextlib
import math
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from imucal.noise import NoiseModel
from imucal.simulation import write_log
from tests.calibration.simulated import Truth, ferraris
from tests.cli.reports import write_report
from tests.cli.run import run

__all__ = ["Kept", "code_blocks", "fill_folder", "missing_lines", "renewed", "run_block", "run_page"]

ROOT = Path(__file__).parents[1]

#: A number, unless it is part of a word such as accel3 or s^2.
_NUMBER = re.compile(r"(?<![\w^.])\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
#: Commands that print a block but are hidden on the page: `<!-- printed by: imucal …; imucal … -->`.
_HIDDEN = re.compile(r"^<!-- printed by: (.*?) -->\n+```\w*\n(.*?)^```", re.MULTILINE | re.DOTALL)
#: Relative tolerance of printed numbers: the last of eight digits depends on the processor.
_EQUAL = 1e-6


def code_blocks(page: Path) -> list[tuple[str, str]]:
    """Return the language and text of every fenced block, in order."""
    return _FENCE.findall(page.read_text(encoding="utf-8"))


class Kept:
    """A command that runs once; other pages copy its output folder."""

    def __init__(self, line: str, name: str) -> None:
        self._line = line
        self._name = name
        self._made: Path | None = None

    def brought(self, line: str, folder: Path) -> bool:
        """Copy the command's output to `folder`; return False for another command and for the first call."""
        if line != self._line:
            return False
        if self._made is None:
            self._made = folder / self._name
            return False
        shutil.copytree(self._made, folder / self._name)
        return True


def run_block(
    language: str,
    text: str,
    folder: Path,
    *,
    kept: Kept | None = None,
    names: dict[str, object] | None = None,
) -> str:
    """Run a python block or the `imucal` lines of a console block, or save a toml block; return the output.

    Other lines of a console block (``pip install …``) and the `kept` command are not run.
    """
    if language == "python":
        with contextlib.chdir(folder):
            exec(compile(text, "the block", "exec"), {} if names is None else names)  # noqa: S102 - our own pages
    elif language == "console":
        printed_text = ""
        for line in re.sub(r"\\\n\s*", " ", text).splitlines():
            if line.startswith("imucal ") and not (kept and kept.brought(line, folder)):
                printed_text += _run(line, folder)
        return printed_text
    elif language == "toml":
        (folder / "limits.toml").write_text(text, encoding="utf-8")
    return ""


def fill_folder(folder: Path, page: Path) -> None:
    """Create the inputs of a page: the sample logs, a `log.mcap`, and a table without a header, `plain.csv`.

    `calibrate.md` and `python.md` also get a `ferraris.mcap`: six faces and three full turns. The `log.mcap`
    has few samples, because no page depends on its fit.
    """
    shutil.copytree(ROOT / "sample_logs", folder / "sample_logs")
    short = ("--duration", "20s") if page.name == "README.md" else ("--rate", "10", "--duration", "6min")
    model = ("N=1e-4 + B=3e-5", "--accel", "N=1e-3", "--seed", "1", "-o", "log.mcap")
    assert run("simulate", *model, *short, cwd=folder).returncode == 0
    rng = np.random.default_rng(1)
    n = 4000
    gravity = np.array([0, 0, 0, 0, 0, 9.81])
    noise = rng.standard_normal((n, 6)) * [1e-3, 1e-3, 1e-3, 2e-2, 2e-2, 2e-2]
    table = np.column_stack([np.arange(n) / 100.0, gravity + noise])
    np.savetxt(folder / "plain.csv", table, delimiter=",", fmt="%.7g")
    if page.name in {"calibrate.md", "python.md"}:
        accel_and_gyro = NoiseModel.parse("N=2e-3"), NoiseModel.parse("N=1.2e-4")
        write_log(ferraris(Truth.draw(rng), accel_and_gyro, rng).recording(), folder / "ferraris.mcap")
    if page.name == "use-in-ci.md":
        for name in ("golden-imucal", "still-imucal"):
            write_report(folder, name)


def run_page(page: Path, folder: Path, *, kept: Kept | None = None) -> Iterator[tuple[str, str]]:
    """Run the blocks of a page in order; yield each printed block with all output and YAML files so far.

    Printed blocks have the language `text`, and in the README also `yaml`.
    """
    hidden = {
        text: commands.split("; ") for commands, text in _HIDDEN.findall(page.read_text(encoding="utf-8"))
    }
    printed = {"text", "yaml"} if page.name == "README.md" else {"text"}
    output = ""
    # A block may use what the blocks above it defined.
    names: dict[str, object] = {"__name__": "__main__"}
    for language, text in code_blocks(page):
        for line in hidden.get(text, ()):
            output += _run_hidden(line, folder)
        output += run_block(language, text.replace("pip install . && ", ""), folder, kept=kept, names=names)
        if language in printed:
            files = "".join(path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.yaml")))
            yield text, output + files


def missing_lines(block: str, output: str) -> list[str]:
    """Return the lines of a block that are not in the output, ignoring line breaks of the output."""
    words = output.split()
    return [line for line in block.splitlines() if not all(map(partial(_is_in, words), line.split("…")))]


def _is_in(words: list[str], part: str) -> bool:
    return not part.strip() or next(_places(part, words), None) is not None


def renewed(block: str, output: str) -> str:
    """Return a block with the numbers of the output; lines whose words are not in the output stay."""
    words = output.split()
    return "\n".join(_with_numbers(line, words) for line in block.split("\n"))


def _places(line: str, words: list[str]) -> Iterator[int]:
    """Yield the positions of a line's words with equal numbers in the output."""
    wanted = line.split()
    for start in _same_words(wanted, words):
        own, other = _numbers(wanted), _numbers(words[start : start + len(wanted)])
        if len(own) == len(other) and np.allclose(own, other, rtol=_EQUAL, atol=0):
            yield start


def _with_numbers(line: str, words: list[str]) -> str:
    """Return a line with the numbers of the most similar place in the output."""
    wanted = line.split()
    own = _numbers(wanted)
    places = {start: _numbers(words[start : start + len(wanted)]) for start in _same_words(wanted, words)}
    distances = {start: _distance(own, other) for start, other in places.items() if len(other) == len(own)}
    if not own or not distances:
        return line
    start = min(distances, key=lambda place: distances[place])
    found = iter(_NUMBER.findall(" ".join(words[start : start + len(wanted)])))
    return _NUMBER.sub(lambda _: next(found), line)


def _distance(own: list[float], other: list[float]) -> float:
    return sum(abs(math.log((a + 1e-9) / (b + 1e-9))) for a, b in zip(own, other, strict=True))


def _same_words(wanted: list[str], words: list[str]) -> Iterator[int]:
    """Yield the positions of the words in the output, ignoring numbers."""
    if not wanted:
        return
    plain, all_plain = [_NUMBER.sub("#", word) for word in wanted], [_NUMBER.sub("#", word) for word in words]
    for start in range(len(words) - len(wanted) + 1):
        if all_plain[start : start + len(plain)] == plain:
            yield start


def _numbers(words: list[str]) -> list[float]:
    return [float(number) for number in _NUMBER.findall(" ".join(words))]


def _run_hidden(line: str, folder: Path) -> str:
    """Run a command that may fail; programs other than imucal run in a shell."""
    if line.startswith("imucal "):
        done = run(*shlex.split(line)[1:], cwd=folder)
        return done.stdout + done.stderr
    subprocess.run(line, shell=True, cwd=folder, check=True)  # noqa: S602 - our own page
    return ""


def _run(line: str, folder: Path) -> str:
    """Run a command line, with optional redirection to a file; return its output."""
    _, *words = shlex.split(line, comments=True)
    words, target = (words[:-2], words[-1]) if ">" in words else (words, None)
    done = run(*words, cwd=folder)
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    if target is not None:
        (folder / target).write_text(done.stdout, encoding="utf-8")
    return done.stdout + done.stderr

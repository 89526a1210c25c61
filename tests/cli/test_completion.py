"""`imucal completion`: scripts for shells, and their suggestions."""

import shutil
import subprocess
from pathlib import Path

import pytest

from imucal.report.exports import TARGETS
from tests.cli.run import run


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_shell_gets_its_script(shell: str, tmp_path: Path) -> None:
    """A shell that is installed finds no mistake in it."""
    done = run("completion", shell, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"_IMUCAL_COMPLETE={shell}_complete" in done.stdout
    program = shutil.which(shell)
    if program is not None:
        (tmp_path / "script").write_text(done.stdout)
        subprocess.run([program, "-n", "script"], cwd=tmp_path, check=True, timeout=60)  # noqa: S603


def test_an_unknown_shell_is_refused(tmp_path: Path) -> None:
    """The message lists the known ones."""
    done = run("completion", "cmd", cwd=tmp_path)
    assert done.returncode == 2
    assert "'cmd' is not one of 'bash', 'zsh', 'fish'" in done.stderr


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("imucal ", {"fit", "export", "check"}),
        ("imucal export --to ", {*TARGETS, "all"}),
        ("imucal export --to o", {"openvins", "orbslam3"}),
        ("imucal check --undecided ", {"pass", "fail"}),
        ("imucal decompose --axis g", {"gyro_x", "gyro_y", "gyro_z"}),
    ],
)
def test_commands_formats_and_choices_are_offered(words: str, offered: set[str], tmp_path: Path) -> None:
    """The script of the shell receives them."""
    count = len(words.split(" ")) - 1
    done = run(cwd=tmp_path, _IMUCAL_COMPLETE="bash_complete", COMP_WORDS=words, COMP_CWORD=str(count))
    found = {line.partition(",")[2] for line in done.stdout.splitlines()}
    assert found >= offered

"""``imucal --version`` and ``python -m imucal``: the running imucal, and conflicts with another package."""

import subprocess
import sys
from pathlib import Path

import imucal
from tests.cli.run import run

FOLDER = Path(imucal.__file__).resolve().parent


def test_the_version_contains_the_folder(tmp_path: Path) -> None:
    """Version, distribution, folder and Python, on one line."""
    done = run("--version", cwd=tmp_path)
    assert done.returncode == 0
    (line,) = done.stdout.splitlines()
    assert line.startswith(f"imucal {imucal.__version__} (imucal-noise) in {FOLDER}, Python 3.")


def test_the_module_is_the_command(tmp_path: Path) -> None:
    """`python -m imucal` runs the same one."""
    done = subprocess.run(
        [sys.executable, "-m", "imucal", "--version"],
        capture_output=True,
        text=True,
        check=True,
        cwd=FOLDER.parent,
    )
    assert done.stdout == run("--version", cwd=tmp_path).stdout


def test_the_other_distribution_is_named(tmp_path: Path) -> None:
    """The line after the version reports that files of both are mixed, and suggests a command."""
    info = tmp_path / "imucal-2.6.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: imucal\nVersion: 2.6.0\n")
    script = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from imucal.cli import main; main(['--version'])"
    )
    done = subprocess.run(  # noqa: S603 - our own words
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=FOLDER.parent
    )
    assert "The distribution imucal 2.6.0, of another project, is installed too" in done.stdout
    assert "Type: pip uninstall imucal imucal-noise" in done.stdout

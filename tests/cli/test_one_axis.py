"""A log of one axis, such as a fibre-optic gyroscope's on a bench, through every command."""

import json
from pathlib import Path

import numpy as np
import pytest

from imucal.report.exports import TARGETS
from tests.cli.run import run

N = 4000


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log of white noise about z, and its report."""
    folder = tmp_path_factory.mktemp("bench")
    rates = np.random.default_rng(88_204).normal(0, 0.01, N)
    rows = "\n".join(f"{i / 100},{rate!r}" for i, rate in enumerate(rates.tolist()))
    (folder / "fog.csv").write_text(f"t,gz_dps\n{rows}\n", encoding="utf-8")
    (folder / "bare.csv").write_text(f"{rows}\n", encoding="utf-8")
    done = run("fit", "fog.csv", "--model", "N + K", "-o", "report", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "Read fog.csv (csv): gyro z: 4000 samples at 100 Hz" in done.stderr
    return folder


def test_the_report_holds_one_axis(bench: Path) -> None:
    """Of white noise of 0.01 deg/s at 100 Hz: 0.001 deg/s/sqrt(Hz), within its interval's reach."""
    document = json.loads((bench / "report" / "report.json").read_text(encoding="utf-8"))
    (axis,) = document["axes"]
    assert axis["name"] == "gyro_z"
    # The interval of N of 4000 samples is about 1.6 % wide each way.
    assert axis["fit"]["terms"]["N"]["value"] == pytest.approx(np.radians(0.001), rel=0.05)
    page = (bench / "report" / "report.html").read_text(encoding="utf-8")
    assert "gyro_z" in page
    assert "gyro_x" not in page
    assert (bench / "report" / "gyro_z.png").exists()


@pytest.mark.usefixtures("pictures_are_blank")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("info", "fog.csv"), "gyroscope columns: gz_dps, by name"),
        (("adev", "fog.csv"), "gyro_z,0.01,1,"),
        (("adev", "bare.csv", "--columns", "t=0,gz=1", "--gyro-unit", "deg/s"), "gyro_z,0.01,1,"),
        (("decompose", "fog.csv", "--model", "N + K", "-o", "bias"), "gyro_z"),
        (("compare", "report", "report"), "gyro_z  N"),
        (("plan", "report"), "gyro_z  at 100 Hz"),
    ],
)
def test_every_command_takes_it(arguments: tuple[str, ...], said: str, bench: Path) -> None:
    """And names that axis alone."""
    done = run(*arguments, cwd=bench)
    assert done.returncode == 0, done.stderr
    assert said in done.stdout
    assert "gyro_x" not in done.stdout
    assert "accel" not in done.stdout


def test_a_filter_model_of_one_axis(bench: Path) -> None:
    """Each axis has its own states, so that none needs the others."""
    done = run("export", "report", "--to", "gm", "-o", "-", cwd=bench)
    assert done.returncode == 0, done.stderr
    axes = done.stdout.partition("\naxes:\n")[2]
    assert axes.startswith("  gyro_z:\n")
    assert "gyro_x" not in axes
    assert "accel" not in axes


def test_it_is_checked_against_limits_of_its_own(bench: Path) -> None:
    """The limits name the required axes."""
    (bench / "limits.toml").write_text('[gyroscope]\naxes = ["z"]\nN = { max = 1.0 }\n', encoding="utf-8")
    done = run("check", "report", "--limits", "limits.toml", cwd=bench)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "gyro_z are present" in done.stdout


@pytest.mark.parametrize("target", sorted(TARGETS))
def test_no_format_makes_up_what_was_not_measured(target: str, bench: Path) -> None:
    """Each format omits the accelerometer with a note, or reports the missing axis and writes nothing."""
    done = run("export", "report", "--to", target, "-o", "-", cwd=bench)
    if done.returncode == 0:
        assert "the report has no accelerometer; the files omit its numbers" in done.stderr
        return
    assert done.returncode == 4
    assert f", which {target} needs; found gyro_z" in done.stderr
    assert done.stdout == ""

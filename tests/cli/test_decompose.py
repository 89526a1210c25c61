"""`imucal decompose`: files, table and refusals."""

import csv
import json
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import FloatArray
from tests.cli.run import SAMPLE_LOGS, run
from tests.cli.test_not_noise import moved, write

pytestmark = pytest.mark.usefixtures("pictures_are_blank")

LOG = "still.csv"
MODEL = ("--model", "N + K")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Make a folder with a log of known noise and a gap."""
    truth = ("N=1e-3 + K=1e-3", "--rate", "50", "--duration", "60s", "--gap", "20s:5s", "--seed", "4")
    assert run("simulate", *truth, "-o", LOG, cwd=tmp_path).returncode == 0
    return tmp_path


def test_files_and_table_contain_the_bias(folder: Path) -> None:
    """Per axis a picture, a table and, where asked for, arrays, whose parts add up; one document."""
    done = run("decompose", LOG, *MODEL, "--axis", "gyro_x", "--axis", "accel_z", "--npz", cwd=folder)
    assert done.returncode == 0, done.stderr
    out = folder / "still-decomposed"
    names = {f"{axis}.{kind}" for axis in ("gyro_x", "accel_z") for kind in ("png", "csv", "npz")}
    assert {path.name for path in out.iterdir()} == {*names, "decomposition.json"}
    assert [line.split()[:2] for line in done.stdout.splitlines()[1:]] == [
        ["gyro_x", "bias"], ["gyro_x", "K"], ["accel_z", "bias"], ["accel_z", "K"],
    ]  # fmt: skip
    with np.load(out / "accel_z.npz") as held:
        arrays = dict(held)
    assert arrays["samples"].shape == (3000,)
    missing = np.isnan(arrays["samples"])
    assert missing.sum() == 250
    npt.assert_allclose(
        (arrays["bias"] + arrays["residual"])[~missing], arrays["samples"][~missing], atol=1e-12
    )
    rows = list(csv.DictReader((out / "accel_z.csv").read_text(encoding="utf-8").splitlines()))
    assert list(rows[0]) == ["time_s", "count", "samples", "bias", "bias_se", "K", "K_se"]
    assert len(rows) == 3000
    npt.assert_allclose([float(row["bias"]) for row in rows], arrays["bias"], rtol=1e-9)
    assert rows[1100]["samples"] == ""
    document = json.loads((out / "decomposition.json").read_text(encoding="utf-8"))
    assert document["schema"] == "imucal/decomposition/1"
    (gyro, accel) = document["axes"]
    assert (gyro["name"], accel["samples"], accel["unit"]) == ("gyro_x", 2750, "m/s^2")
    assert accel["components"][0]["mean"] == pytest.approx(9.80665, abs=0.05)
    assert accel["residual"]["std"] == pytest.approx(1e-3 * 50**0.5, rel=0.1)
    assert (out / "gyro_x.png").read_bytes().startswith(b"\x89PNG")


def test_rows_come_as_often_as_asked_for(folder: Path) -> None:
    """Samples are averaged around the time of each row."""
    done = run("decompose", LOG, *MODEL, "--axis", "gyro_x", "--every", "1s", "-o", "bias", cwd=folder)
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((folder / "bias" / "gyro_x.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 60
    assert (rows[0]["time_s"], rows[0]["count"]) == ("0.49", "50")
    assert (rows[22]["samples"], rows[22]["count"]) == ("", "0")


def test_json_is_the_document(folder: Path) -> None:
    """Standard output holds that alone; -q leaves nothing on standard error."""
    done = run("decompose", LOG, *MODEL, "--axis", "gyro_y", "--json", "-q", cwd=folder)
    assert done.returncode == 0
    written = (folder / "still-decomposed" / "decomposition.json").read_text(encoding="utf-8")
    assert json.loads(done.stdout) == json.loads(written)
    assert done.stderr == ""


def test_a_folder_of_its_own_is_written_again_and_others_are_left_alone(folder: Path) -> None:
    """Other folders end with exit code 5 before the log is read, and stay unchanged."""
    for _ in range(2):
        done = run("decompose", LOG, *MODEL, "--axis", "gyro_x", "-q", "-o", "bias", cwd=folder)
        assert done.returncode == 0, done.stderr
    done = run("decompose", LOG, *MODEL, "--axis", "gyro_y", "-q", "-o", "bias", cwd=folder)
    assert done.returncode == 0, done.stderr
    # The document is about these axes, so no file of another axis stays.
    assert {path.name for path in (folder / "bias").iterdir()} == {
        "decomposition.json",
        "gyro_y.csv",
        "gyro_y.png",
    }
    mine = folder / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("mine", encoding="utf-8")
    done = run("decompose", LOG, "-o", "mine", cwd=folder)
    assert (done.returncode, done.stdout) == (5, "")
    assert done.stderr.startswith("Error: mine: contains thesis.tex but no imucal decomposition; ")
    done = run("decompose", LOG, "-o", LOG, cwd=folder)
    assert done.returncode == 5
    assert done.stderr.startswith(f"Error: {LOG}: is a file, expected a folder or nothing")
    done = run("decompose", LOG, "-o", f"{LOG}/bias", cwd=folder)
    assert done.returncode == 5
    assert done.stderr.startswith(f"Error: {LOG}/bias: ")


def test_an_axis_that_is_not_there_is_named(folder: Path) -> None:
    """The message lists the existing axes; an invalid name is a usage error."""
    (folder / "gyro.csv").write_text(
        "t,gx,gy,gz\n" + "".join(f"{i / 100},{i % 7}e-3,{i % 5}e-3,{i % 3}e-3\n" for i in range(500)),
        encoding="utf-8",
    )
    done = run("decompose", "gyro.csv", "--gyro-unit", "rad/s", "--axis", "accel_x", cwd=folder)
    assert done.returncode == 4
    assert done.stderr.endswith("Error: gyro.csv: no axis accel_x; found gyro_x, gyro_y, gyro_z\n")
    assert run("decompose", LOG, "--axis", "mag_x", cwd=folder).returncode == 2
    assert run("decompose", LOG, "--every", "0s", cwd=folder).returncode == 2


def test_strict_turns_a_warning_into_an_exit_code(folder: Path) -> None:
    """A log with gaps: the files are written, the code is 4."""
    arguments = ("decompose", str(SAMPLE_LOGS / "with_gaps.csv"), *MODEL, "--axis", "gyro_x", "-q")
    assert run(*arguments, cwd=folder).returncode == 0
    assert run(*arguments, "--strict", cwd=folder).returncode == 4
    assert (folder / "with_gaps-decomposed" / "gyro_x.png").exists()


def test_what_is_not_noise_ends_with_code_4_unless_forced(tmp_path: Path) -> None:
    """The files are written, because the picture shows the motion; the message contains the next step."""
    write(tmp_path / "log.csv", moved)
    done = run("decompose", "log.csv", "--model", "N", "--axis", "gyro_x", "-q", cwd=tmp_path)
    assert done.returncode == 4
    assert done.stderr == (
        "Error: log.csv: not noise: the IMU was moved; do not use these numbers; log-decomposed was written; "
        "fit the quiet part with --skip 2.3s --take 17.7s\n"
    )
    assert (tmp_path / "log-decomposed" / "gyro_x.png").exists()
    done = run("decompose", "log.csv", "--model", "N", "--axis", "gyro_x", "-q", "--force", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


def test_effects_taken_out_are_reported(tmp_path: Path) -> None:
    """A step is no noise, so the fit takes it out; here it is in the bias."""

    def stepped(rows: FloatArray) -> None:
        rows[500:, 1] += 2e-3

    write(tmp_path / "log.csv", stepped)
    done = run("decompose", "log.csv", "--model", "N + K", "--axis", "gyro_x", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = "gyro_x: the fit removed a step; the bias shown here still contains it"
    assert said in done.stderr.splitlines()

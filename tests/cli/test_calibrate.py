"""`imucal calibrate`: table, files, JSON and its schema, the corrected log, and refusals."""

import json
import re
from dataclasses import replace
from pathlib import Path
from unittest import mock

import jsonschema
import numpy as np
import pytest

import imucal
from imucal.calibration.checks import worse_than_before
from imucal.calibration.document import Intrinsics, load_intrinsics, schema
from imucal.noise import NoiseModel
from imucal.recording import Recording, Sensor
from imucal.simulation import write_log
from tests.calibration.simulated import FACES, GRAVITY, Log, Truth, attitudes, ferraris, log
from tests.cli.reports import write_report
from tests.cli.run import run, run_process

pytestmark = pytest.mark.usefixtures("pictures_are_blank")

NOISE = NoiseModel.parse("N=2e-3 + B=5e-4"), NoiseModel.parse("N=1.5e-4 + B=2e-5")
PLACE = ("--gravity", str(GRAVITY))


def drawn(seed: int = 8200, up: np.ndarray | None = None) -> Log:
    rng = np.random.default_rng(seed)
    return log(Truth.draw(rng), NOISE, attitudes(18, rng) if up is None else up, rng, rest_s=3.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log of 18 rests, and its calibration."""
    place = tmp_path_factory.mktemp("calibrate")
    write_log(drawn().recording(), place / "poses.csv")
    done = run("calibrate", "poses.csv", *PLACE, "-q", cwd=place)
    assert (done.returncode, done.stderr) == (0, "")
    return place


def test_the_table_shows_every_parameter(folder: Path) -> None:
    """At 80 columns side by side; findings, files and the next command on standard error."""
    done = run("calibrate", "poses.csv", *PLACE, "-o", "again", cwd=folder, COLUMNS="80")
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert lines[0].startswith("poses.csv: 1 min 28 s, 18 rests (2.7 s) in 18 attitudes, 17 turns")
    assert lines[2].split() == ["ACCELEROMETER", "(±", "95", "%)", "GYROSCOPE", "(±", "95", "%)"]
    for name in ("scale x", "misalignment zy", "bias z", "g-sensitivity", "|f| at rest: error up to"):
        assert name in done.stdout
    assert max(map(len, lines)) <= 80
    said = done.stderr.splitlines()
    assert said[-2].startswith("Wrote again: calibration.json")
    assert said[-1] == "Next: imucal export again --to kalibr (or openvins, px4, python, …)"


def test_a_narrow_terminal_and_a_pipe_show_the_same_numbers(folder: Path) -> None:
    """40 columns: nothing is lost, nothing is wider; without Unicode ± is +-."""
    arguments = ("calibrate", "poses.csv", *PLACE, "--no-files", "-q")
    wide, narrow = (run(*arguments, cwd=folder, COLUMNS=columns).stdout for columns in ("200", "40"))
    assert max(map(len, narrow.splitlines())) <= 40
    assert [word for word in wide.split() if word not in narrow.split()] == []
    plain = run_process(*arguments, cwd=folder, PYTHONIOENCODING="ascii").stdout
    assert "+- 95 %" in plain


def test_json_fits_its_schema_and_is_the_python_result(folder: Path) -> None:
    """The file, standard output and `imucal.calibrate` agree; the schema refuses a wrong document."""
    jsonschema.Draft202012Validator.check_schema(schema())
    written = json.loads((folder / "poses-calibration" / "calibration.json").read_text(encoding="utf-8"))
    jsonschema.validate(written, schema())
    printed = run("calibrate", "poses.csv", *PLACE, "--no-files", "--json", "-q", cwd=folder)
    assert json.loads(printed.stdout) == written
    found = imucal.calibrate(imucal.read(folder / "poses.csv"), gravity=GRAVITY)
    np.testing.assert_array_equal(written["accelerometer"]["C"], found.accelerometer.C)
    assert found.gyroscope is not None
    np.testing.assert_array_equal(written["gyroscope"]["G"], found.gyroscope.G)
    assert written["accelerometer"]["parameters"]["scale_x"]["unit"] == "%"
    for key, value in (("schema", "imucal/calibration/2"), ("rests", [{}]), ("verdict", "fine")):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**written, key: value}, schema())
    # What exports read back is the same to the last digit.
    first, second = Intrinsics.of(found), load_intrinsics(folder / "poses-calibration")
    for name in ("C_a", "b_a", "diagonal_C", "C_g", "b_g", "G", "means"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.si


def test_a_diagonal_and_an_accelerometer_alone_fit_the_schema(tmp_path: Path) -> None:
    """Unknown values are null."""
    write_log(drawn(8201, FACES).recording(), tmp_path / "faces.csv")
    done = run("calibrate", "faces.csv", *PLACE, "--no-gyro", "--json", cwd=tmp_path)
    document = json.loads(done.stdout)
    jsonschema.validate(document, schema())
    assert document["gyroscope"] is None
    assert document["accelerometer"]["model"] == "diagonal"
    assert document["accelerometer"]["parameters"]["misalignment_zx"]["value"] is None
    assert "[not-observable] accel: The accelerometer's misalignment yx" in done.stderr
    table = run("calibrate", "faces.csv", *PLACE, "--no-gyro", "--no-files", "-q", cwd=tmp_path).stdout
    assert "misalignment zx  not observable" in table
    assert "GYROSCOPE" not in table


def test_a_noise_report_is_used_and_kept(folder: Path) -> None:
    """Its models are in the document and its copy is in the folder, until a run without it."""
    write_report(folder)
    done = run("calibrate", "poses.csv", *PLACE, "--noise", "still-imucal", "-o", "with", cwd=folder)
    assert done.returncode == 0
    document = json.loads((folder / "with" / "calibration.json").read_text(encoding="utf-8"))
    assert document["noise"]["accel"]["origin"] == "report"
    assert imucal.load_report(folder / "with" / "noise.json").axes
    assert run("calibrate", "poses.csv", *PLACE, "-o", "with", cwd=folder).returncode == 0
    assert not (folder / "with" / "noise.json").exists()


@pytest.mark.parametrize("name", ["corrected.csv", "corrected.mcap"])
def test_the_corrected_log_is_read_again(name: str, folder: Path) -> None:
    """Gravity at every rest, no rate; its own calibration finds nothing."""
    done = run("calibrate", "poses.csv", *PLACE, "--no-files", "--apply", name, "-q", cwd=folder)
    assert done.returncode == 0, done.stderr
    again = imucal.calibrate(imucal.read(folder / name), gravity=GRAVITY)
    assert max(abs(rest.before) for rest in again.rests) < 5e-3
    assert again.gyroscope is not None
    for parameters in (again.accelerometer.parameters, again.gyroscope.parameters):
        for axis in "xyz":
            assert abs(parameters[f"scale_{axis}"].value or 1.0) < 0.02
            assert abs(parameters[f"bias_{axis}"].value or 1.0) < 1e-3
    refused = run("calibrate", "poses.csv", *PLACE, "--no-files", "--apply", name, cwd=folder)
    assert refused.returncode == 5
    assert f"{name}: exists already" in refused.stderr


def test_a_corrected_log_needs_both_sensors(tmp_path: Path) -> None:
    """The message shows the call in Python."""
    one = drawn().recording()
    write_accelerometer(one, tmp_path / "accel.csv")
    arguments = ("accel.csv", "--rate", "100", "--accel-unit", "m/s^2", *PLACE, "-q")
    done = run("calibrate", *arguments, "--apply", "x.csv", cwd=tmp_path)
    assert done.returncode == 4
    assert "apply the calibration to the log: imucal apply" in " ".join(done.stderr.split())


def write_accelerometer(recording: Recording, path: Path, factor: float = 1.0) -> None:
    """Write a table with the accelerometer alone."""
    own = [s.samples * factor for s in recording.series if s.sensor is Sensor.ACCELEROMETER]
    np.savetxt(path, np.column_stack(own), delimiter=",", header="ax,ay,az", comments="", fmt="%.8g")


def changed(one: Log, kind: str) -> Recording:
    """Return a log with something wrong."""
    accelerometer, gyroscope = one.accelerometer.copy(), one.gyroscope.copy()
    if kind == "clipped":
        accelerometer[:, 2] = np.minimum(accelerometer[:, 2], 9.0)
    elif kind == "swapped":
        gyroscope = gyroscope[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
    elif kind == "mirrored":
        gyroscope = gyroscope * [-1.0, 1.0, 1.0]
    elif kind == "degrees":
        gyroscope = np.degrees(gyroscope)
    elif kind == "dead":
        accelerometer[:, 1] = 0.0
    return replace(one, accelerometer=accelerometer, gyroscope=gyroscope).recording()


@pytest.mark.parametrize(
    ("kind", "up", "said"),
    [
        ("never moved", FACES[:1], "rests in 3 s: found 1, expected at least 6; put the IMU down on"),
        ("too few", FACES[:4], ": found 4, expected at least 6; "),
        ("one attitude", np.tile(FACES[0], (8, 1)), "have the same attitude within 10°"),
        ("clipped", None, "accel_z is clipped at 9 in "),
        ("dead", None, "accel_y never changes; check the driver and the cable"),
        (
            "swapped",
            None,
            "nothing was written; try --no-gyro for the accelerometer alone, or --force",
        ),
        ("mirrored", None, "axes found; nothing was written"),
        ("degrees", None, "unit-suspect found; nothing was written"),
    ],
)
def test_a_log_that_cannot_be_calibrated_ends_with_code_4(
    kind: str, up: np.ndarray | None, said: str, tmp_path: Path
) -> None:
    """The message contains the log, the reason and the next step; nothing is written."""
    if kind == "one attitude" and up is not None:
        # A small tilt between the rests separates them.
        up = up + np.random.default_rng(2).normal(0, 0.04, up.shape)
        up /= np.linalg.norm(up, axis=1)[:, None]
    write_log(changed(drawn(8202, up), kind), tmp_path / "log.csv")
    done = run("calibrate", "log.csv", *PLACE, cwd=tmp_path)
    assert done.returncode == 4, done.stdout + done.stderr
    assert said in done.stderr
    assert "Error: log.csv: " in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
    # A finding breaks into lines at the width of the terminal.
    text = " ".join(done.stderr.split())
    if kind == "swapped":
        assert "the gyroscope's x is along y and y is along -x of the accelerometer." in text
    if kind == "degrees":
        assert re.search(
            r"it shows 5\d\.?\d? times the rates at which gravity turns. Run again with --gyro-unit deg/s;",
            text,
        )
    if kind == "mirrored":
        assert "the gyroscope's x is along -x of the accelerometer." in text


def test_swapped_axes_are_calibrated_after_reordering(tmp_path: Path) -> None:
    """Or without the gyroscope, or by force."""
    write_log(changed(drawn(), "swapped"), tmp_path / "log.csv")
    for option in ("--no-gyro", "--force"):
        done = run("calibrate", "log.csv", *PLACE, option, "-o", "out", "-q", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert (tmp_path / "out" / "calibration.json").exists()


def test_a_log_in_g_is_refused_with_the_option_that_helps(tmp_path: Path) -> None:
    """With the suggested option the result equals the result of the log in m/s²."""
    one = drawn().recording()
    write_accelerometer(one, tmp_path / "g.csv", 1 / 9.80665)
    arguments = ("calibrate", "g.csv", "--rate", "100", *PLACE, "-o", "out")
    done = run(*arguments, "--accel-unit", "m/s^2", cwd=tmp_path)
    assert done.returncode == 4
    assert "the unit looks like g\nUse --accel-unit g.\n" in done.stderr
    option = done.stderr.strip().removesuffix(".").rpartition("Use ")[2].split()
    right = run(*arguments, *option, cwd=tmp_path)
    assert right.returncode == 0, right.stderr
    found = load_intrinsics(tmp_path / "out")
    expected = imucal.calibrate(one, gravity=GRAVITY, gyro=False)
    np.testing.assert_allclose(found.C_a, expected.accelerometer.C, atol=1e-5)
    assert found.C_g is None


def test_short_rests_are_refused_with_the_option_that_helps(tmp_path: Path) -> None:
    """Rests of 1 s, less the margins; typed as the message shows, the log is calibrated."""
    rng = np.random.default_rng(8210)
    one = log(Truth.draw(rng), NOISE, attitudes(14, rng), rng, rest_s=1.0)
    write_log(one.recording(), tmp_path / "short.csv")
    done = run("calibrate", "short.csv", *PLACE, cwd=tmp_path)
    assert done.returncode == 4
    assert "14 rests last 0.4 s or longer; put the IMU down" in done.stderr
    assert done.stderr.endswith("\nUse --rest-at-least 0.4s.\n")
    option = done.stderr.strip().removesuffix(".").rpartition("Use ")[2].split()
    again = run("calibrate", "short.csv", *PLACE, *option, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert "info [short]: 14 rests of 14 last less than 2 s" in again.stderr


def test_rests_in_a_hand_are_refused_with_the_option_that_helps(tmp_path: Path) -> None:
    """A tremor of different size in each rest."""
    rng = np.random.default_rng(8211)
    one = log(Truth.draw(rng), NOISE, attitudes(14, rng), rng, rest_s=4.0)
    gyroscope = one.gyroscope.copy()
    for k, (first, end) in enumerate(one.spans):
        size = 0.0005 if k < 5 else 0.005
        gyroscope[first:end] += size * np.sin(np.arange(end - first) * 0.4)[:, None]
    write_log(replace(one, gyroscope=gyroscope).recording(), tmp_path / "hand.csv")
    done = run("calibrate", "hand.csv", *PLACE, cwd=tmp_path)
    assert done.returncode == 4
    assert "14 rests have the tremor of a hand; put the IMU down" in done.stderr
    assert done.stderr.endswith("\nUse --in-hand.\n")
    again = run("calibrate", "hand.csv", *PLACE, "--in-hand", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert "info [in-hand]" in again.stderr


def test_raw_counts_are_calibrated(tmp_path: Path) -> None:
    """The table shows the scale of counts; PX4's file is refused, Kalibr's is not."""
    one = drawn(8212)
    counts = np.round(np.column_stack([4000 * one.gyroscope, 400 * one.accelerometer]) + 32768)
    np.savetxt(tmp_path / "raw.csv", counts, delimiter=",", header="gx,gy,gz,ax,ay,az", comments="", fmt="%d")
    unknown = run("calibrate", "raw.csv", "--rate", "100", cwd=tmp_path)
    assert unknown.returncode == 3
    assert "give the unit count for raw counts" in unknown.stderr
    typed = re.findall(r"--(?:gyro|accel)-unit count", unknown.stderr)
    assert len(typed) == 2
    raw = ("raw.csv", "--rate", "100", *" ".join(typed).split())
    done = run("calibrate", *raw, *PLACE, "-o", "out", "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "per m/s²" in done.stdout
    found = load_intrinsics(tmp_path / "out")
    expected = imucal.calibrate(one.recording(), gravity=GRAVITY)
    np.testing.assert_allclose(400 * found.C_a, expected.accelerometer.C, atol=2e-3)
    assert run("export", "out", "--to", "kalibr", "-o", "-", cwd=tmp_path).returncode == 0
    # A report in SI is multiplied by the scale that the calibration finds.
    write_report(tmp_path)
    noisy = run("calibrate", *raw, *PLACE, "--noise", "still-imucal", "-o", "noisy", cwd=tmp_path)
    assert noisy.returncode == 0, noisy.stderr
    assert "info [noise-scaled] accel: The noise report of accel is in SI units" in noisy.stderr
    refused = run("export", "out", "--to", "px4", "-o", "-", cwd=tmp_path)
    assert refused.returncode == 4
    assert "read it with --accel-scale and --gyro-scale" in refused.stderr
    every = run("export", "out", "--to", "all", "-o", "every", cwd=tmp_path)
    assert every.returncode == 0
    assert "px4 is not written: raw.csv: an autopilot corrects samples in m/s²" in every.stderr


def test_turns_of_a_known_angle_show_the_scale_of_the_gyroscope(tmp_path: Path) -> None:
    """Full turns on a table; another angle is refused with the angles that were found."""
    rng = np.random.default_rng(8213)
    truth = Truth.draw(rng)
    write_log(ferraris(truth, NOISE, rng, deviation=0.002).recording(), tmp_path / "table.csv")
    arguments = ("calibrate", "table.csv", *PLACE, "--json", "--no-files", "-q")
    done = run(*arguments, "--turns", "360deg", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    jsonschema.validate(document, schema())
    assert [turn["known_deg"] for turn in document["turns"] if turn["known_deg"] is not None] == [360.0] * 3
    assert {len(turn["residual_deg"]) for turn in document["turns"]} == {2, 3}
    without = json.loads(run(*arguments, cwd=tmp_path).stdout)
    for axis in "xyz":
        half = [one["gyroscope"]["parameters"][f"scale_{axis}"] for one in (document, without)]
        assert half[0]["high"] - half[0]["low"] < half[1]["high"] - half[1]["low"]
    table = run("calibrate", "table.csv", *PLACE, "--no-files", "--turns", "360°±0.1°", "-q", cwd=tmp_path)
    assert "Turns (3 by a known angle): " in table.stdout
    kept = run("calibrate", "table.csv", *PLACE, "--turns", "360deg", "-q", cwd=tmp_path)
    assert kept.returncode == 0
    limits = '[calibration.gyroscope]\nresidual = { max = 5, unit = "deg" }\n'
    (tmp_path / "limits.toml").write_text(limits, encoding="utf-8")
    checked = run("check", "table-calibration", "--limits", "limits.toml", cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    wrong = run(*arguments, "--turns", "180deg", cwd=tmp_path)
    assert wrong.returncode == 4
    assert "no turn by 180° was found: the turns in place have 36" in wrong.stderr
    no_gyro = run(*arguments, "--turns", "360deg", "--no-gyro", cwd=tmp_path)
    assert no_gyro.returncode == 2
    assert "turns of a known angle calibrate the gyroscope; omit one of them" in no_gyro.stderr
    for text in ("1e9deg", "deg", "5deg", "360deg+-0deg", "360deg+-100deg", "99999deg"):
        refused = run(*arguments, "--turns", text, cwd=tmp_path)
        assert refused.returncode == 2, text
        assert "Invalid value for '--turns'" in refused.stderr


def test_a_calibration_that_is_worse_than_none_is_not_written(folder: Path, tmp_path: Path) -> None:
    """Exit code 4 and no files; with --force the page says so."""
    good = imucal.calibrate(imucal.read(folder / "poses.csv"), gravity=GRAVITY)
    rests = tuple(replace(rest, before=rest.residual / 10, residual=0.05) for rest in good.rests)
    bad = replace(good, rests=rests)
    bad = replace(bad, findings=(*worse_than_before(bad), *good.findings))
    arguments = ("calibrate", str(folder / "poses.csv"), *PLACE, "-o", "out")
    with mock.patch("imucal.calibration.calibrate", return_value=bad):
        done = run(*arguments, cwd=tmp_path)
        assert done.returncode == 4
        assert "error [worse-than-before] accel: The calibration makes the accelerometer worse" in done.stderr
        assert "worse-than-before found; nothing was written" in done.stderr
        assert not (tmp_path / "out").exists()
        forced = run(*arguments, "--force", cwd=tmp_path)
    assert forced.returncode == 0
    page = (tmp_path / "out" / "calibration.html").read_text(encoding="utf-8")
    assert "<code>worse-than-before</code>" in page
    assert "The calibration makes the accelerometer worse" in page


def test_warnings_and_wrong_options(folder: Path, tmp_path: Path) -> None:
    """--strict ends with 4 after the table; wrong options with 2, a folder of another kind with 5."""
    done = run("calibrate", "poses.csv", "--strict", "--no-files", cwd=folder)
    assert done.returncode == 4
    assert "gravity-unknown found; --strict allows no warning" in done.stderr
    assert "scale x" in done.stdout
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("words", encoding="utf-8")
    log_path = str(folder / "poses.csv")
    for arguments, code, said in (
        ((log_path, "--latitude", "95"), 2, "--latitude"),
        ((log_path, "--gravity", "1"), 2, "--gravity"),
        ((log_path, "--frame", "ned"), 2, "'ned' is not one of 'kalibr', 'imu-tk', 'nearest'"),
        ((log_path, "--apply", "x.txt"), 2, "'x.txt' ends in '.txt'"),
        ((log_path, "--rest-at-least", "long"), 2, "is not a duration"),
        ((log_path, "--noise", "nowhere"), 3, "nowhere: no such file"),
        (("nowhere.csv",), 3, "nowhere.csv: can't be opened"),
        ((log_path, "-o", "thesis"), 5, "thesis: contains thesis.tex but no calibration"),
        ((log_path, "-o", "thesis/thesis.tex/x"), 5, "Not a directory"),
    ):
        done = run("calibrate", *arguments, cwd=tmp_path)
        assert done.returncode == code, done.stderr
        assert said in done.stderr


def test_export_of_a_calibration(folder: Path, tmp_path: Path) -> None:
    """One file, standard output, or all formats are written; formats of noise reports are refused."""
    place = str(folder / "poses-calibration")
    one = run("export", place, "--to", "OpenVINS", "-o", "imu.yaml", cwd=tmp_path)
    assert (one.returncode, one.stdout) == (0, "imu.yaml\n")
    assert "run imucal calibrate with --noise REPORT" in one.stderr
    printed = run("export", f"{place}/calibration.json", "--to", "openvins", "-o", "-", "-q", cwd=tmp_path)
    assert printed.stdout == (tmp_path / "imu.yaml").read_text(encoding="utf-8")
    (tmp_path / "renamed.json").write_bytes((Path(place) / "calibration.json").read_bytes())
    renamed = run("export", "renamed.json", "--to", "openvins", "-o", "-", "-q", cwd=tmp_path)
    assert renamed.stdout == printed.stdout
    every = run("export", place, "--to", "all", "-o", "configs", cwd=tmp_path)
    assert every.returncode == 0
    assert len(every.stdout.splitlines()) == len(list((tmp_path / "configs").iterdir())) == 15
    (tmp_path / "mine.yaml").write_text("mine", encoding="utf-8")
    write_report(tmp_path, "still")
    for arguments, code, said in (
        ((place, "--to", "rovio"), 2, "no calibration format 'rovio'; choose one of kalibr, openvins"),
        ((place, "--to", "kalbir"), 2, "did you mean kalibr?"),
        ((place, "--to", "c", "--to", "yaml", "-o", "-"), 2, "standard output takes one format"),
        (("still", "--to", "imu-tk"), 2, "imu-tk is for a calibration, and still is not one"),
        ((place, "--to", "kalibr", "-o", "mine.yaml"), 5, "was not written by imucal"),
    ):
        done = run("export", *arguments, cwd=tmp_path)
        assert done.returncode == code, done.stderr
        assert said in done.stderr


@pytest.mark.parametrize("name", ["fresh/", "a/b/"])
def test_an_export_to_a_name_with_a_slash_makes_a_folder(folder: Path, tmp_path: Path, name: str) -> None:
    if name == "a/b/":
        (tmp_path / "a").mkdir()
    place = str(folder / "poses-calibration")
    assert run("export", place, "--to", "openvins", "-o", name, cwd=tmp_path).returncode == 0
    assert (tmp_path / name).is_dir()
    assert [file.suffix for file in (tmp_path / name).iterdir()] == [".yaml"]


@pytest.mark.parametrize("command", ["compare {0} nothing.json", "plan {0}"])
def test_a_calibration_in_place_of_a_report_is_named(folder: Path, tmp_path: Path, command: str) -> None:
    place = folder / "poses-calibration"
    result = run(*command.format(place).split(), cwd=tmp_path)
    assert (result.returncode, result.stdout) == (3, "")
    assert "a calibration, not a report of noise" in result.stderr
    match = re.search(r"type 'imucal (.+?)'", " ".join(result.stderr.split()))
    assert match is not None
    assert run(*match[1].split(), cwd=tmp_path).returncode == 0


def test_six_rests_can_be_planned(tmp_path: Path) -> None:
    """Without misalignment, which they do not determine."""
    model = ("N=1e-4 + B=1e-5", "--accel", "N=1e-3 + B=3e-4", "--rate", "100")
    planned = run("plan", *model, "--rests", "6", cwd=tmp_path)
    assert planned.returncode == 0
    assert "6 rests of 5 s" in planned.stdout
    assert run("plan", *model, "--rests", "5", cwd=tmp_path).returncode == 2

"""``imucal thermal``: the table, files and exit codes; export, apply and simulate of temperature ramps."""

import json
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.temperature.document import load_thermal
from tests.cli.run import run
from tests.readers.logs import Message, Samples, header, imu_messages, store, write_mcap

RAMP = ("simulate", "N=1e-4 + B=1e-5", "--accel", "N=1e-3", "--temperature=-10:60", "--duration", "1h")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with ramp.csv, its truth.json, its result in ramp-thermal, and cold.csv without one."""
    folder = tmp_path_factory.mktemp("ramp")
    done = run("simulate", "N=1e-4", "--duration", "10min", "--rate", "2", "-o", "cold.csv", cwd=folder)
    assert done.returncode == 0
    done = run(*RAMP, "--rate", "2", "--seed", "31", "--json", "-q", "-o", "ramp.csv", cwd=folder)
    assert done.returncode == 0, done.stderr
    (folder / "truth.json").write_text(done.stdout, encoding="utf-8")
    done = run("thermal", "ramp.csv", cwd=folder)
    assert done.returncode == 0, done.stderr
    (folder / "table.txt").write_text(done.stdout, encoding="utf-8")
    assert "Wrote ramp-thermal: thermal.json, thermal.html, 2 pictures" in done.stderr
    return folder


def test_the_table(folder: Path) -> None:
    """It fits 80 columns; narrower terminals get a paragraph for each axis."""
    head, verdict, _, titles, *rows = (folder / "table.txt").read_text(encoding="utf-8").splitlines()
    assert head == "ramp.csv: 1 h, -10 → 60 → -10 °C, at most 2.3 K/min"
    assert verdict == "Good"
    assert titles.split() == ["axis", "before", "after", "unseen", "cubic", "hysteresis", "unit", "order"]
    assert [row.split()[0] for row in rows if row] == [
        "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z",
    ]  # fmt: skip
    narrow = run("thermal", "ramp.csv", "--no-files", "-q", cwd=folder, COLUMNS="40")
    assert max(map(len, narrow.stdout.splitlines())) <= 40


def test_json_has_the_true_effect(folder: Path) -> None:
    """The lag and the change of the bias over the range are those of the simulation."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["thermal"]
    done = run("thermal", "ramp.csv", "--json", "-q", "--no-files", cwd=folder)
    document = json.loads(done.stdout)
    assert document["schema"] == "imucal/thermal/1"
    lags = []
    for number, (axis, points) in enumerate(zip(document["axes"], document["points"], strict=True)):
        own = truth[axis["sensor"]][number % 3]
        curve = axis["curve"]
        u = (np.array(points["temperature"]) - truth["middle_c"]) / truth["half_k"]
        true = u * own[0] + u**2 * own[1] + u**3 * own[2]
        found = np.array(points["bias"])
        off = (found - found.mean()) - (true - true.mean())
        assert np.abs(off).max() < 3 * axis["held_out"]
        # A gradient explains the same lag in another way.
        lags += [curve["lag_s"]] if curve["kind"] == "lagged" else []
    assert len(lags) >= 4
    assert lags == pytest.approx([truth["lag_s"]] * len(lags), rel=0.1)


def test_logs_that_show_nothing(folder: Path) -> None:
    """Exit code 4, and what to do; --strict also refuses a warning."""
    done = run("thermal", "cold.csv", cwd=folder)
    assert done.returncode == 4
    assert "the log has no temperature" in done.stderr
    assert not (folder / "cold-thermal").exists()
    half = run("thermal", "ramp.csv", "--take", "30min", "--strict", "--no-files", cwd=folder)
    assert half.returncode == 4
    assert "thermal-one-branch found; --strict allows no warning" in half.stderr


def test_all_exports_are_written(folder: Path) -> None:
    """One file for each program; a noise format is not one of them."""
    done = run("export", "ramp-thermal", "--to", "all", "-o", "files/", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (folder / "files").iterdir()) == [
        "ardupilot_thermal.parm", "imu_thermal.h", "imu_thermal.m", "imu_thermal.py", "imu_thermal.yaml",
        "px4_thermal.params",
    ]  # fmt: skip
    printed = run("export", "ramp-thermal", "--to", "c", "-o", "-", cwd=folder)
    assert printed.stdout == (folder / "files" / "imu_thermal.h").read_text(encoding="utf-8")
    wrong = run("export", "ramp-thermal", "--to", "kalibr", cwd=folder)
    assert wrong.returncode == 2
    assert "choose one of px4, ardupilot, c, python, matlab, yaml" in wrong.stderr


def test_a_column_with_another_name_is_named(folder: Path) -> None:
    """The error says how, and the columns that it suggests work."""
    text = (folder / "ramp.csv").read_text(encoding="utf-8").replace("temperature [degC]", "heat", 1)
    (folder / "heat.csv").write_text(text, encoding="utf-8")
    done = run("thermal", "heat.csv", "--no-files", cwd=folder)
    assert done.returncode == 4
    assert "such as temp=8 in --columns" in " ".join(done.stderr.split())
    columns = "t=0,g=1:4,a=4:7,temp=7"
    done = run("thermal", "heat.csv", "--no-files", "--columns", columns, "--time-unit", "ns", cwd=folder)
    assert done.returncode == 0, done.stderr


def test_the_speed_of_a_ramp_is_planned(folder: Path) -> None:
    """The folder of a ramp and an error; without one, or with another source, it is a usage error."""
    done = run("plan", "ramp-thermal", "--gyro-error", "5deg/h", "--accel-error=0.5mg", cwd=folder)
    assert done.returncode == 0, done.stderr
    title, *lines = done.stdout.splitlines()
    assert title == "Speed of a ramp from -10 to 60 °C and back, for a curve without a lag"
    assert lines[0].startswith("gyro_x: 5 deg/h at 0.")
    document = json.loads(run("plan", "ramp-thermal", "--gyro-error=5deg/h", "--json", cwd=folder).stdout)
    assert document["schema"] == "imucal/thermal-plan/1"
    assert len(document["axes"]) == 3
    for arguments, text in (
        (("ramp-thermal",), "add --gyro-error 5deg/h, --accel-error 0.5mg, or both"),
        (("ramp-thermal", "--gyro-error", "5km"), "'5km' is not a positive number with one of the units"),
        (("N=1e-4", "--rate", "100", "--gyro-error", "5deg/h"), "need the folder of 'imucal thermal'"),
    ):
        wrong = run("plan", *arguments, cwd=folder)
        assert wrong.returncode == 2
        assert text in " ".join(wrong.stderr.split())


def test_a_table_is_corrected(folder: Path) -> None:
    """Only the samples change, by the curve at the temperature of the row; a second time is refused."""
    done = run("apply", "ramp-thermal", "ramp.csv", "-o", "corrected.csv", cwd=folder)
    assert done.returncode == 0, done.stderr
    before = np.genfromtxt(folder / "ramp.csv", delimiter=",", skip_header=1)
    after = np.genfromtxt(folder / "corrected.csv", delimiter=",", skip_header=1)
    assert np.array_equal(before[:, [0, 7]], after[:, [0, 7]])
    assert after[:, 1:4].std(axis=0).max() < 1.5e-4
    assert after[:, 4:7].mean(axis=0) == pytest.approx(before[:, 4:7].mean(axis=0), abs=0.15)
    again = run("apply", "ramp-thermal", "corrected.csv", "-o", "twice.csv", cwd=folder)
    assert again.returncode == 4
    assert "it is already corrected" in again.stderr
    assert not (folder / "twice.csv").exists()


def test_messages_are_corrected_by_another_topic(folder: Path) -> None:
    """The temperature has a topic of its own, at another rate: it is interpolated at each message."""
    rows = np.genfromtxt(folder / "ramp.csv", delimiter=",", skip_header=1)[:1500]
    stamps = rows[:, 0].astype(np.int64)
    truth = Samples(stamps=stamps, log=stamps + 1000, gyro=rows[:, 1:4], accel=rows[:, 4:7])
    types, kind = store(), "sensor_msgs/msg/Temperature"
    heat = [
        Message(
            topic="/imu/temperature",
            type=kind,
            log=stamp + 2000,
            data=bytes(types.serialize_cdr(types.types[kind](header(types, stamp), degrees, 0.0), kind)),
        )
        for stamp, degrees in zip(stamps[::4].tolist(), rows[::4, 7].tolist(), strict=True)
    ]
    messages = sorted([*imu_messages(truth), *heat], key=lambda message: message.log)
    write_mcap(folder / "flight.mcap", messages)
    done = run("apply", "ramp-thermal", "flight.mcap", "-o", "corrected.mcap", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["samples"] == 1500
    found = imucal.read(folder / "corrected.mcap")
    curve = load_thermal(folder / "ramp-thermal")["gyro_y"].curve
    for place in (400, 1100):
        # Behind a lag, a temperature that rises steadily is lower by the lag times its rate.
        degrees = float(np.interp(place, np.arange(1500), rows[:, 7]))
        rate = (rows[place + 100, 7] - rows[place - 100, 7]) / 100
        lagging = np.array([degrees - rate * curve.lag_s])
        bias = float(curve.bias(np.array([degrees]), lagging)[0])
        change = rows[place, 2] - found["gyro_y"].samples[place]
        assert change == pytest.approx(bias, abs=3e-5)
    assert found.temperature is not None


def test_a_warmer_log_is_named(folder: Path) -> None:
    """Beyond the ramp the end of the curve is used, and the finding says so."""
    head, *rows = (folder / "ramp.csv").read_text(encoding="utf-8").splitlines()
    warmer = [f"{row.rpartition(',')[0]},{float(row.rpartition(',')[2]) + 20}" for row in rows]
    (folder / "warm.csv").write_text("\n".join([head, *warmer]) + "\n", encoding="utf-8")
    done = run("apply", "ramp-thermal", "warm.csv", "-o", "warm-corrected.csv", cwd=folder)
    assert done.returncode == 0
    assert "warning [thermal-range]" in done.stderr
    done = run("apply", "ramp-thermal", "cold.csv", "-o", "cold-corrected.csv", cwd=folder)
    assert (done.returncode, "the log has no temperature" in done.stderr) == (4, True)


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (("--temperature=60:-10",), "does not heat"),
        (("--temperature=warm",), "'warm' is not LOW:HIGH in degrees Celsius, such as -10:60"),
        (("--temperature=0:hot",), "'0:hot' is not LOW:HIGH in degrees Celsius, such as -10:60"),
        (("--temperature=0:inf",), "'0:inf' is not LOW:HIGH in degrees Celsius, such as -10:60"),
        (("--temperature=0:50", "--rests", "8"), "--temperature excludes --gap and --rests"),
        (("--temperature=0:50", "-o", "x.mcap"), "x.mcap has no place for a temperature"),
    ],
)
def test_wrong_ramps(more: tuple[str, ...], text: str, tmp_path: Path) -> None:
    """They are usage errors, and nothing is written."""
    out = () if "-o" in more else ("-o", "x.csv")
    done = run("simulate", "N=1e-4", *more, *out, cwd=tmp_path)
    assert done.returncode == 2
    assert text in " ".join(done.stderr.split())
    assert not list(tmp_path.iterdir())

"""`imucal drift`: table, JSON, picture and refusals."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import numpy.testing as npt
from PIL import Image

import imucal
from imucal.noise.model import NoiseModel
from tests.benchmarks.drift import drawn_rms, printed
from tests.cli.reports import write_report
from tests.cli.run import run, run_process
from tests.remote.one_axis import OPTIONS, one_axis
from tests.report.synthetic import consumer_report, small_report


def test_a_report_gives_a_table(tmp_path: Path) -> None:
    """It contains value, limits, unit, axis and the largest term, and the times beyond the log."""
    write_report(tmp_path, "a", small_report())
    done = run("drift", "a", "--times", "10s,1min", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stderr == ""
    assert done.stdout.splitlines() == [
        "Drift without aiding after a rest of 1 min: one standard deviation [95 % limits]",
        "",
        "angle",
        "  10 s    0.20 [0.19, 0.59] deg           gyro_x    N 100 %  extrapolated",
        "  1 min   0.63 [0.63, 4.40] deg           gyro_x    N 100 %  extrapolated",
        "",
        "velocity through tilt",
        "  10 s    0.19 [0.19, 0.50] m/s           gyro_x    N 100 %  extrapolated",
        "  1 min   3.5 [3.5, 20.3] m/s             gyro_x    N 100 %  extrapolated",
        "",
        "position through tilt",
        "  10 s    0.72 [0.72, 1.68] m             gyro_x    N 100 %  extrapolated",
        "  1 min   76 [76, 385] m                  gyro_x    N 100 %  extrapolated",
        "",
        "extrapolated: the log is shorter than 5 times rest plus time; the model is",
        "  assumed to remain valid",
    ]


def test_both_sensors_determine_heading_and_both_parts(tmp_path: Path) -> None:
    """In the order of the library; nothing is extrapolated of three hours."""
    write_report(tmp_path, "a")
    lines = run("drift", "a", cwd=tmp_path).stdout.splitlines()
    assert lines[1] == "z is vertical (by the accelerometer)"
    names = [line for line in lines[2:] if line and not line.startswith(" ")]
    assert names == [one.name for one in imucal.drift(consumer_report()).quantities]
    assert "extrapolated" not in "".join(lines)
    each = run("drift", "a", "--all-axes", "--times", "1s", cwd=tmp_path).stdout
    assert [each.count(f" {name} ") for name in ("gyro_x", "gyro_z", "accel_y")] == [3, 1, 2]
    plain = run_process("drift", "a", cwd=tmp_path, PYTHONIOENCODING="ascii")
    assert (plain.returncode, plain.stdout.splitlines()) == (0, lines)


def test_json_is_the_drift(tmp_path: Path) -> None:
    """Values are in SI, unknown values are null, and times increase."""
    write_report(tmp_path, "a", small_report())
    done = run("drift", "a", "--times", "1min,1s,60s", "--rest", "30s", "--json", "-q", cwd=tmp_path)
    document = json.loads(done.stdout)
    assert {key: document[key] for key in ("schema", "rest_s", "level", "vertical")} == {
        "schema": "imucal/drift/1",
        "rest_s": 30.0,
        "level": 0.95,
        "vertical": "",
    }
    found = imucal.drift(small_report(), [1.0, 60.0], rest_s=30.0)
    for told, known in zip(document["quantities"], found.quantities, strict=True):
        assert (told["name"], told["unit"]) == (known.name, known.unit)
        for point, same in zip(told["points"], known.points, strict=True):
            assert set(point) == {field.name for field in fields(same)}
            assert (point["time_s"], point["axis"], point["seen"]) == (same.time_s, same.axis, False)
            for key in ("value", "low", "high", "share"):
                npt.assert_allclose(point[key], float(getattr(same, key)))


def test_numbers_are_those_of_drawn_coasts() -> None:
    """In long records of a known model, the rms of coasts is within 3 % of the printed numbers."""
    times = (1.0, 10.0, 60.0)
    text = "N=1e-3 + B=3e-4 + K=2e-5"
    drawn = drawn_rms(NoiseModel.parse(text), times, coasts=8000, rng=np.random.default_rng(4302))
    told = printed(text, times)
    for name, rms in drawn.items():
        npt.assert_allclose(rms, told[name], rtol=0.03)


def test_a_log_is_characterised_first_and_drawn(tmp_path: Path) -> None:
    """The picture is complete, and standard output contains only the table."""
    (tmp_path / "log.csv").write_bytes(one_axis())
    log = ("log.csv", *OPTIONS, "--rest", "1s", "--times", "1s")
    done = run("drift", *log, "-o", "drift.png", "-q", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.startswith("Drift without aiding after a rest of 1 s")
    with Image.open(tmp_path / "drift.png") as picture:
        assert picture.size == (1600, 688)
    svg = run("drift", *log, "-o", "drift.svg", cwd=tmp_path)
    assert svg.stderr.splitlines()[-1] == "drift.svg"
    assert (tmp_path / "drift.svg").read_text(encoding="utf-8").lstrip().startswith("<?xml")


def test_refuses_with_what_to_do(tmp_path: Path) -> None:
    """A name of no picture, times of nothing, no folder; and data that are not noise."""
    write_report(tmp_path, "a", small_report())
    for arguments, code, said in (
        (
            ("a", "-o", "x.jpg"),
            2,
            "x.jpg is not the name of a picture; use one of the endings .png, .svg, .pdf",
        ),
        (
            ("a", "--rest", "0"),
            2,
            "rest 0 s and time 1 s; expected at least a sample (0.005 s) each",
        ),
        (("a", "--times", "1s,x"), 2, "'x' is not a duration; write seconds, or for example 90s, 5min, 2.5h"),
        (("a", "-o", "none/x.png"), 5, "none/x.png: can't be written: No such file or directory"),
        (("none",), 3, "none: can't be opened"),
    ):
        done = run("drift", *arguments, cwd=tmp_path)
        assert done.returncode == code, done.stderr
        assert said in done.stderr
    rng = np.random.default_rng(4303)
    # An axis that says nothing.
    table = np.column_stack([np.arange(2000) / 100, rng.standard_normal(2000) * 1e-3, np.zeros(2000)])
    np.savetxt(tmp_path / "dead.csv", table, delimiter=",", header="t,gx,gy", comments="")
    wrong = ("drift", "dead.csv", "--gyro-unit", "rad/s", "--times", "1s", "--rest", "1s", "-q")
    done = run(*wrong, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (4, "")
    assert "nothing was predicted; record again at rest, or force it" in done.stderr
    assert run(*wrong, "--force", cwd=tmp_path).stdout.startswith("Drift without aiding")

"""`imucal export`: files, streams and exit codes."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from imucal.report.exports import TARGETS
from tests.cli.reports import write_report
from tests.cli.run import SAMPLE_LOGS, run
from tests.report.synthetic import small_report


@pytest.fixture
def still(tmp_path: Path) -> str:
    """Return the name of a report folder."""
    return write_report(tmp_path)


def test_a_file_is_written_under_its_own_name(still: str, tmp_path: Path) -> None:
    """Its path is on standard output, notes are on standard error."""
    done = run("export", still, "--to", "kalibr", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "kalibr_imu.yaml\n")
    assert "are enough for the fitted spectrum, so they are larger than N and K" in done.stderr
    assert yaml.safe_load((tmp_path / "kalibr_imu.yaml").read_text())["update_rate"] == 200.0


def test_standard_output_takes_one_format(still: str, tmp_path: Path) -> None:
    """Nothing but the file is on it; report.json itself will do for a report."""
    fitted = ("--as-fitted",)
    done = run("export", f"{still}/report.json", "--to", "lio_sam", "-o", "-", "-q", *fitted, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert yaml.safe_load(done.stdout)["lio_sam"]["imuGyrNoise"] == 1.3e-4
    done = run("export", still, "--to", "all", "-o", "-", cwd=tmp_path)
    assert done.returncode == 2
    assert "standard output takes one format; name a folder" in done.stderr


@pytest.mark.parametrize(("targets", "count"), [(("all",), len(TARGETS)), (("px4", "sdf", "px4"), 2)])
def test_several_formats_go_to_a_folder(
    targets: tuple[str, ...], count: int, still: str, tmp_path: Path
) -> None:
    """The folder is made; every path is printed."""
    options = [option for target in targets for option in ("--to", target)]
    done = run("export", still, *options, "-o", "a/b", "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    paths = done.stdout.splitlines()
    assert len(paths) == count
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == sorted(
        Path(path).name for path in paths
    )


def test_policy_inflation_and_topic_reach_the_file(still: str, tmp_path: Path) -> None:
    """Each option changes its number, and a comment reports it."""
    options = ["--axis", "x", "--inflate", "white=2, walk=10", "--rostopic", "/my/imu"]
    options += ["--as-fitted"]
    done = run("export", still, "--to", "kalibr", "-o", "-", "-q", *options, cwd=tmp_path)
    data = yaml.safe_load(done.stdout)
    assert data["gyroscope_noise_density"] == 2.4e-4
    assert data["gyroscope_random_walk"] == pytest.approx(1.1e-5)
    assert data["rostopic"] == "/my/imu"
    assert "# axes: x alone" in done.stdout
    assert "white (N) x 2, walk (K) x 10; ALREADY in the numbers" in done.stdout


def test_n_and_k_of_the_fit_state_what_they_leave_out(still: str, tmp_path: Path) -> None:
    """On standard error which are bounds, in the file that a filter with them is too sure."""
    done = run("export", still, "--to", "kalibr", "-o", "-", "--as-fitted", cwd=tmp_path)
    assert "K was not detected on gyro_y, accel_y" in done.stderr
    assert "without flicker and Gauss-Markov terms, so a filter may be overconfident" in done.stdout


def test_the_longest_time_without_aiding_reaches_the_file(still: str, tmp_path: Path) -> None:
    """As a duration; a longer time requires less walk."""
    walks = []
    for time in ("30s", "10min"):
        done = run("export", still, "--to", "kalibr", "-o", "-", "-q", "--coast", time, cwd=tmp_path)
        walks.append(yaml.safe_load(done.stdout)["accelerometer_random_walk"])
    assert "filter aided every 1 s or slower, horizon 600 s" in done.stdout
    assert walks[1] < walks[0]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("--to", "kalibr", "--coast", "1"), 2, "1 s is not longer than 1 s, the time between two updates"),
        (("--to", "kalibr", "--coast", "soon"), 2, "'soon' is not a duration"),
        (("--to", "kalbir"), 2, "no downstream format 'kalbir'; did you mean kalibr?"),
        (("--to", "kalibr", "--inflate", "pink=2"), 2, "'pink=2' is not a factor of white, walk, flicker;"),
        (
            ("--to", "kalibr", "--inflate", "walk=-1"),
            2,
            "'walk=-1' is not a factor of white, walk, flicker;",
        ),
        (("--to", "kalibr", "--axis", "w"), 2, "'w' is not one of 'worst', 'rms', 'x', 'y', 'z'"),
        (("--to", "kalibr", "-o", "no/where.yaml"), 5, "no/where.yaml: can't be written: No such file"),
        (
            ("--to", "kalibr", "--topic", "/imu"),
            2,
            "still-imucal is a report, and topic applies to a log only;",
        ),
    ],
)
def test_what_cannot_be_done_is_one_message(
    arguments: tuple[str, ...], code: int, message: str, still: str, tmp_path: Path
) -> None:
    """No traceback, nothing on standard output, no file."""
    done = run("export", still, *arguments, cwd=tmp_path)
    assert done.returncode == code
    assert message in " ".join(done.stderr.split())
    assert done.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == [still]


def test_a_report_without_an_accelerometer_gives_its_half(tmp_path: Path) -> None:
    """The file has the gyroscope's keys, and standard error reports the missing sensor."""
    name = write_report(tmp_path, report=small_report())
    done = run("export", name, "--to", "kalibr", cwd=tmp_path)
    assert done.returncode == 0
    assert "the report has no accelerometer" in done.stderr
    data = yaml.safe_load((tmp_path / "kalibr_imu.yaml").read_text())
    assert {key for key in data if "noise" in key} == {"gyroscope_noise_density"}


def test_another_name_is_answered_by_the_formats_own(still: str, tmp_path: Path) -> None:
    """Nav2 reads what ros writes; a hyphen more or less is the same name."""
    done = run("export", still, "--to", "nav2", "-o", "-", cwd=tmp_path)
    assert "nav2: written as ros (ROS sensor_msgs/Imu covariances)" in done.stderr
    assert "angular_velocity_covariance" in yaml.safe_load(done.stdout)
    assert "written as" not in run("export", still, "--to", "Lio_Sam", "-o", "-", cwd=tmp_path).stderr
    assert (
        run("export", still, "--to", "nav2", "--to", "ros", "-o", "a", cwd=tmp_path).stdout.count("\n") == 1
    )


def test_something_else_than_a_report_is_refused(tmp_path: Path) -> None:
    """A JSON file of another kind, and a missing one."""
    (tmp_path / "a.json").write_text("{}")
    assert run("export", "a.json", "--to", "vins", cwd=tmp_path).returncode == 3
    done = run("export", "missing.json", "--to", "vins", cwd=tmp_path)
    assert done.returncode == 3
    assert "missing.json: no such file" in done.stderr


def test_a_log_is_characterised_first(tmp_path: Path) -> None:
    """The file names the log it came from."""
    log = str(SAMPLE_LOGS / "too_short.db3")
    done = run("export", log, "--to", "isaac-ros", "-o", "-", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    values = yaml.safe_load(done.stdout)["/**"]["ros__parameters"]
    assert all(value > 0 for value in values.values())
    assert "too_short.db3" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_noise_that_the_fit_leaves_out_is_named_and_the_suggested_factor_includes_it(tmp_path: Path) -> None:
    """Spikes are no part of N, but a filter meets them."""
    rng = np.random.default_rng(5704)
    samples = 1e-3 * rng.standard_normal(30_000)
    samples[rng.integers(0, 30_000, 15)] = 0.05
    table = np.column_stack([np.arange(30_000) / 100, samples])
    np.savetxt(tmp_path / "spikes.csv", table, delimiter=",", header="t,gy", comments="", fmt="%.9g")
    assert run("fit", "spikes.csv", "--gyro-unit", "rad/s", "-o", "r", "-q", cwd=tmp_path).returncode == 0
    done = run("export", "r", "--to", "kalibr", "-o", "-", cwd=tmp_path)
    text = "gyro_y: the log contains more noise than these numbers, because the fit leaves out spikes"
    assert text in done.stdout
    suggested = re.findall(r"inflat\w+ (white=\S+) includes it", done.stdout + done.stderr)
    assert len(suggested) == 2
    assert suggested[0] == suggested[1]
    done = run("export", "r", "--to", "kalibr", "-o", "-", "--inflate", suggested[0], cwd=tmp_path)
    assert text not in done.stdout
    assert "more noise" not in done.stderr
    done = run("drift", "r", "--times", "1s", cwd=tmp_path)
    assert "gyro_y drifts more than this, because the fit leaves out spikes" in done.stderr

"""``imucal fleet report``, and fleets in ``export``, ``check`` and ``compare``: output and exit codes."""

import json
from pathlib import Path

import numpy as np
import pytest

import imucal
from tests.cli.run import run
from tests.fleet.simulated_store import TERMS, write_store

pytestmark = pytest.mark.usefixtures("pictures_are_blank")

#: The axes of all logs.
NAMES = ("gyro_x", "accel_z")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a working folder with three fleets of eight units, and logs of a like and of an unlike unit."""
    place = tmp_path_factory.mktemp("fleets")
    # The second model has 1.5 times the noise of the first.
    for name, seed, models in (
        ("fleet", 3, ("ACME-6",)),
        ("later", 4, ("ACME-6",)),
        ("louder", 5, ("BOLT-9", "ACME-6")),
    ):
        write_store(
            place / name,
            units=8,
            models=models,
            seed=seed,
            special=False,
            failures=False,
            weak="",
            temperatures=(25.0, 25.0),
            names=NAMES,
        )
    write_store(place / "two", units=2, special=False, failures=False, weak="", names=NAMES)
    write_store(place / "loose", units=2, labelled=False, special=False, failures=False, weak="", names=NAMES)
    for name, factor in (("like.npz", 1.0), ("other.npz", 1.8)):
        rng = np.random.default_rng(5)
        rates = [
            imucal.NoiseModel.parse(
                " + ".join(f"{term}={factor * TERMS[sensor, term][1]}" for term in ("N", "B", "K"))
            ).simulate(20_000, rate_hz=200.0, rng=rng)
            for sensor in ("gyroscope", "accelerometer")
        ]
        columns = {
            "time (s)": np.arange(20_000) / 200,
            "gx (rad/s)": rates[0],
            "az (m/s^2)": rates[1] + 9.80665,
        }
        np.savez(place / name, **columns)  # type: ignore[arg-type] # its last argument is a flag
    return place


def test_report_writes_its_files_and_prints_the_result(folder: Path) -> None:
    """Paths on standard output, one sentence on the other."""
    done = run("fleet", "report", "fleet", "--no-pictures", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["fleet/fleet.json", "fleet/fleet.csv", "fleet/fleet.html"]
    assert done.stderr.endswith(".\n")
    document = json.loads((folder / "fleet" / "fleet.json").read_text(encoding="utf-8"))
    higher = run("fleet", "report", "fleet", "--no-pictures", "--no-html", "--content", "99%", cwd=folder)
    assert higher.stdout.split() == ["fleet/fleet.json", "fleet/fleet.csv"]
    again = json.loads((folder / "fleet" / "fleet.json").read_text(encoding="utf-8"))
    one, other = (each["models"][0]["terms"][0] for each in (document, again))
    assert other["tolerance"] > one["tolerance"]
    assert other["median"] == one["median"]


def test_report_lists_what_is_missing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An old page is removed if the new page can't be drawn."""

    def broken(*_: object) -> str:
        msg = "no ticks"
        raise ArithmeticError(msg)

    monkeypatch.delenv("IMUCAL_DEBUG", raising=False)
    monkeypatch.setattr("imucal.fleet.files.render_fleet_page", broken)
    (folder / "two" / "fleet.html").write_text("of yesterday")
    done = run("fleet", "report", "two", "--no-pictures", cwd=folder)
    assert done.stdout.split() == ["two/fleet.json", "two/fleet.csv"]
    assert "warning [not-drawn]: fleet.html is missing: the calculation failed" in done.stderr
    assert not (folder / "two" / "fleet.html").exists()


def test_report_lists_the_labels_to_type(folder: Path) -> None:
    """Where no log has a unit."""
    done = run("fleet", "report", "loose", "--no-pictures", cwd=folder)
    assert done.returncode == 0
    assert "to count them, run the fleet with --labels '{unit}.mcap'" in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("fleet", "report", "nothing"), 3, "expected the folder of a fleet"),
        (("export", "two", "--to", "kalibr"), 4, "found 2 units, expected at least 3 for a tolerance bound"),
        (
            ("export", "like.npz", "--median", "--to", "kalibr"),
            2,
            "is not a fleet; omit --median",
        ),
        (
            ("export", "fleet", "--sensor", "X", "--to", "kalibr"),
            3,
            "expected one of the sensor models: 'ACME-6'",
        ),
        (("export", "fleet", "--rate", "9", "--to", "kalibr"), 2, "without options for a log"),
        (("compare", "fleet", "like.npz"), 2, "imucal check like.npz --fleet fleet"),
        (("compare", "fleet", "https://h/a&b.npz"), 2, "imucal check 'https://h/a&b.npz' --fleet fleet"),
        (("compare", "a", "b", "--sensor", "X"), 2, "is not a fleet; omit --sensor"),
        (
            ("check", "like.npz", "--fleet", "nothing"),
            3,
            "expected the folder of a fleet that imucal fleet run writes",
        ),
        (("check", "like.npz", "--sensor", "X"), 2, "give --fleet FLEET too"),
        (("check", "like.npz", "--fleet", "two"), 4, "found 2 units of ACME-6, expected at least 3"),
    ],
)
def test_contradicting_options_are_reported(
    folder: Path, words: tuple[str, ...], code: int, text: str
) -> None:
    """With the exit code of its kind."""
    done = run(*words, cwd=folder)
    assert done.returncode == code, done.stderr
    assert text in " ".join(done.stderr.split())


def test_a_fleet_is_exported(folder: Path) -> None:
    """The default is the bound, the option selects the median, and a comment names the choice."""
    bound = run("export", "fleet", "--to", "kalibr", "-o", "-", cwd=folder)
    median = run("export", "fleet", "--median", "--to", "kalibr", "-o", "-", cwd=folder)
    assert "every number is the 95/95 tolerance bound" in bound.stdout
    assert "enough for gyro_x, 95/95" in bound.stdout
    assert "95/95 tolerance bound of 8 units" in bound.stdout
    assert "every number is the median unit" in median.stdout

    def density(text: str) -> float:
        line = next(line for line in text.splitlines() if line.startswith("gyroscope_noise_density"))
        return float(line.split()[1])

    assert density(bound.stdout) > density(median.stdout)


def test_two_fleets_are_compared(folder: Path) -> None:
    """Six tests; two of one sensor model do not differ."""
    done = run("compare", "fleet", "later", cwd=folder)
    assert done.returncode == 0, done.stdout
    assert "no significant difference (p adjusted for 6 tests" in done.stdout
    assert done.stderr == "A: fleet\nB: later\n"
    louder = run("compare", "fleet", "louder", "--sensor", "ACME-6", cwd=folder)
    assert louder.returncode == 1
    assert "5 of 6 terms differ" in louder.stdout


def test_a_log_is_asked_whether_it_is_one_of_the_fleet(folder: Path) -> None:
    """Exit 0 for a unit like the others, 1 for one of 1.8 times the noise; JSON and JUnit as ever."""
    like = run("check", "like.npz", "--fleet", "fleet", "-q", cwd=folder)
    assert like.returncode == 0, like.stdout
    assert "gyro_x  N in [" in like.stdout
    other = run("check", "other.npz", "--fleet", "fleet", "--json", "--junit", "out.xml", "-q", cwd=folder)
    assert other.returncode == 1
    rows = json.loads(other.stdout)["rows"]
    failed = {row["where"] for row in rows if row["verdict"] == "fail" and row["subject"].startswith("N in")}
    assert failed == set(NAMES)
    assert "the next unit of ACME-6 is in" in (folder / "out.xml").read_text(encoding="utf-8")

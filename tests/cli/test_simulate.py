"""`imucal simulate`: logs of known truth."""

import json
from pathlib import Path

import pytest

from tests.cli.run import run


def test_the_truth_is_printed_as_json(tmp_path: Path) -> None:
    """Model, rate, samples and gaps, as they were made."""
    done = run(
        "simulate", "N=1e-3", "--rate", "50", "--duration", "20s", "--gap", "5s:1s", "-o", "a.csv", "--json",
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    truth = json.loads(done.stdout)
    assert truth["gyroscope"]["model"] == "N=0.001"
    assert truth["samples"] == 950
    assert truth["gaps"] == [{"start_s": 5.0, "duration_s": 1.0}]
    assert len((tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()) == 951


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["N=x"], "'x' is not a number"),
        (["N=1 + N=2"], "N appears more than once; only GM may"),
        (["N=-1"], "N must be finite and not negative, got -1.0"),
        (["N=1", "--gap", "5s"], "'5s' is not START:LENGTH, such as 60s:2s"),
        (
            ["N=1", "--duration", "long"],
            "'long' is not a duration; write seconds, or for example 90s, 5min, 2.5h",
        ),
    ],
)
def test_a_mistake_is_a_usage_error_with_a_correction(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    """Exit code 2 and nothing written."""
    done = run("simulate", *arguments, "-o", "a.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())
    assert list(tmp_path.iterdir()) == []


def test_an_existing_log_is_not_overwritten(tmp_path: Path) -> None:
    """Exit code 5."""
    (tmp_path / "a.csv").write_text("mine", encoding="utf-8")
    done = run("simulate", "N=1", "-o", "a.csv", cwd=tmp_path)
    assert done.returncode == 5
    assert done.stderr.startswith("Error: a.csv: exists already")


@pytest.mark.parametrize("duration", ["0", "1000000d"])
def test_a_length_that_makes_no_log_is_a_usage_error(duration: str, tmp_path: Path) -> None:
    """A single sample, or a log larger than any disk, is refused."""
    done = run("simulate", "N=1e-3", "--duration", duration, "-o", "log.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert "samples; expected 1 to 1e+09" in done.stderr
    assert list(tmp_path.iterdir()) == []

"""Tests of the skips of tests without real recordings."""

from pathlib import Path

import pytest

from tests.real_data import real_data


def test_all_tests_without_recordings_skip_for_one_reason(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Pytest merges equal reasons into one line; the reason contains advice."""
    monkeypatch.setenv("IMUCAL_REAL_DATA", str(tmp_path / "nowhere"))
    reasons = set()
    for name in ("a.bag", "b.csv"):
        with pytest.raises(pytest.skip.Exception) as skipped:
            real_data("real", name)
        reasons.add(str(skipped.value))
    assert reasons == {"no real recordings here; set IMUCAL_REAL_DATA to the folder that holds them"}


def test_a_missing_recording_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """If the folder exists, the reason contains the missing file."""
    monkeypatch.setenv("IMUCAL_REAL_DATA", str(tmp_path))
    with pytest.raises(pytest.skip.Exception, match=r"^real/a\.bag is missing in the folder"):
        real_data("real", "a.bag")
    (tmp_path / "b.csv").touch()
    assert real_data("b.csv") == tmp_path / "b.csv"

"""Without the real recordings a run of the tests says so once."""

from pathlib import Path

import pytest

from tests.real_data import real_data


def test_all_tests_without_recordings_skip_for_one_reason(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Pytest folds equal reasons into a line with their number; this one says what to do."""
    monkeypatch.setenv("IMUCAL_REAL_DATA", str(tmp_path / "nowhere"))
    reasons = set()
    for name in ("a.bag", "b.csv"):
        with pytest.raises(pytest.skip.Exception) as skipped:
            real_data("real", name)
        reasons.add(str(skipped.value))
    assert reasons == {"no real recordings here; set IMUCAL_REAL_DATA to the folder that holds them"}


def test_a_missing_recording_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Where the folder is there, what is not in it is said by name."""
    monkeypatch.setenv("IMUCAL_REAL_DATA", str(tmp_path))
    with pytest.raises(pytest.skip.Exception, match=r"^real/a\.bag is missing in the folder"):
        real_data("real", "a.bag")
    (tmp_path / "b.csv").touch()
    assert real_data("b.csv") == tmp_path / "b.csv"

"""Tests of atomic writes: a file is written completely or not at all."""

from pathlib import Path

import pytest

from imucal import atomic
from imucal.atomic import replacing
from imucal.errors import WriteError


def test_an_interrupted_write_keeps_the_old_file_only(tmp_path: Path) -> None:
    """Ctrl-C during a write loses nothing."""
    target = tmp_path / "report.json"
    target.write_text("old", encoding="utf-8")

    def interrupted() -> None:
        with replacing(target) as scratch:
            scratch.write_text("half", encoding="utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert target.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_complete_write_replaces_the_old_file(tmp_path: Path) -> None:
    """The scratch folder is removed."""
    target = tmp_path / "report.json"
    target.write_text("old", encoding="utf-8")
    with replacing(target) as scratch:
        scratch.write_text("new", encoding="utf-8")
    assert target.read_text(encoding="utf-8") == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_a_missing_folder_is_a_write_error(tmp_path: Path) -> None:
    """The error contains the path and advice."""
    target = tmp_path / "nowhere" / "a.json"
    with pytest.raises(WriteError) as caught, replacing(target):
        pass
    assert str(caught.value) == f"{target}: can't be written: No such file or directory; choose another place"


def test_only_files_of_imucal_are_replaced(tmp_path: Path) -> None:
    target = tmp_path / "imu.yaml"
    target.write_text("# tuned by hand\n", encoding="utf-8")
    with pytest.raises(WriteError) as caught, replacing(target, ours="written by imucal"):
        pass
    expected = f"{target}: exists and was not written by imucal; move it away, or choose another place"
    assert str(caught.value) == expected
    target.write_text("# written by imucal 0.1\n", encoding="utf-8")
    with replacing(target, ours="written by imucal") as scratch:
        scratch.write_text("new", encoding="utf-8")
    assert target.read_text(encoding="utf-8") == "new"


def test_a_device_is_not_replaced() -> None:
    """A rename onto it would remove it."""
    with (
        pytest.raises(WriteError, match="/dev/null: not a regular file"),
        replacing(Path("/dev/null")),
    ):
        pass
    assert not Path("/dev/null").is_file()


def test_ctrl_c_right_after_the_scratch_folder_is_made_removes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(folder: Path, _: Path) -> None:
        folder.mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr(atomic, "_make_scratch", interrupted)
    with pytest.raises(KeyboardInterrupt), replacing(tmp_path / "log.csv"):
        pass
    assert list(tmp_path.iterdir()) == []

"""The contract of every format: what its module offers, and how files are told apart."""

from pathlib import Path

import pytest

from imucal.errors import ReadError
from imucal.readers import FORMATS, Format, describe, read
from imucal.readers.formats import detect, load


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_every_format_has_a_reader(entry: Format) -> None:
    """`read` and `describe`, documented, and named in `__all__`."""
    module = load(entry)
    assert module.__doc__
    for name in ("read", "describe"):
        assert getattr(module, name).__doc__
        assert name in module.__all__  # type: ignore[attr-defined]


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_every_format_refuses_what_only_starts_like_it(entry: Format, tmp_path: Path) -> None:
    """The first bytes of a format and then noise: a message that starts with the path."""
    for number, magic in enumerate(entry.magic or (b"a,b\n",)):
        path = tmp_path / f"{number}{entry.suffixes[0]}"
        path.write_bytes(magic + bytes(range(256)) * 4)
        if entry.magic:
            assert detect(path) == entry
        with pytest.raises(ReadError) as caught:
            read(path)
        assert str(caught.value).startswith(str(path))
        try:
            assert not describe(path).imu_topics
        except ReadError as error:
            assert str(error).startswith(str(path))  # noqa: PT017 - one of two ways to say it


def test_first_bytes_go_before_the_ending(tmp_path: Path) -> None:
    """A bag that is called .txt is a bag."""
    path = tmp_path / "log.txt"
    path.write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    assert detect(path).name == "ROS 1 bag"
    path.write_text("a,b\n1,2\n", encoding="utf-8")
    assert detect(path).name == "text"


def test_needs_a_log() -> None:
    """Without a path there is nothing to read."""
    with pytest.raises(ValueError, match="no log: name at least one file"):
        read()

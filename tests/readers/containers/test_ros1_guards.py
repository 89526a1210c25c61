"""The bytes that show that a record's header is that of the one before."""

import pytest

from imucal.readers.containers.ros1 import _guards


@pytest.mark.parametrize(
    "head",
    [
        b"time=12345678",
        b"0123time=12345678",
        b"time=12345678abc",
        b"time=12345678" + b"abcdefghijk" * 2,
    ],
)
def test_all_but_the_time_is_guarded(head: bytes) -> None:
    """Every byte before and behind the eight of the time, once."""
    guards = _guards(head)
    assert all(head[at : at + len(part)] == part for at, part in guards)
    guarded = [place for at, part in guards for place in range(at, at + len(part))]
    at = head.index(b"time=") + 5
    assert guarded == [place for place in range(len(head)) if not at <= place < at + 8]


def test_a_header_without_a_time_is_guarded_whole() -> None:
    assert _guards(b"op=2") == ((0, b"op=2"),)

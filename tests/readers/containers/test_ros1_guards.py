"""The words that show that a record's header is that of the one before."""

import pytest

from imucal.readers.containers.ros1_chunks import _guards


@pytest.mark.parametrize(
    ("head", "covered"),
    [
        (b"time=12345678", [(0, 4), (1, 4)]),
        (b"0123time=12345678", [(0, 8), (1, 8)]),
        (b"time=12345678abc", [(0, 4), (1, 4), (13, 2), (14, 2)]),
        (b"time=12345678a", [(0, 4), (1, 4), (13, 1)]),
        (b"time=12345678" + b"abcdefghijk" * 2, [(0, 4), (1, 4), (13, 8), (21, 8), (27, 8)]),
    ],
)
def test_all_but_the_time_is_guarded(head: bytes, covered: list[tuple[int, int]]) -> None:
    """Every byte before and behind the eight of the time, in words of its bytes."""
    guards = _guards(head)
    assert guards is not None
    places = sorted({(offset, int(kind[2:])) for offset, kind, _ in guards})
    assert places == covered
    for offset, kind, value in guards:
        assert value == int.from_bytes(head[offset : offset + int(kind[2:])], "little")
    bytes_of_words = {place for offset, size in places for place in range(offset, offset + size)}
    at = head.index(b"time=") + 5
    assert bytes_of_words == {place for place in range(len(head)) if not at <= place < at + 8}


def test_a_header_without_a_time_has_none() -> None:
    """Then every record is checked by itself."""
    assert _guards(b"op=2") is None

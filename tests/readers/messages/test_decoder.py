"""Decoding of messages in every layout, byte by byte; a message of another size is damaged."""

import struct
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest

from imucal.readers.containers import Batch
from imucal.readers.files import DamagedError
from imucal.readers.messages.definitions import Field, defined
from imucal.readers.messages.loader import Block
from imucal.readers.messages.plain import BinaryDecoder, is_reachable

TEXT = "time t\nstring s\nfloat64[3] g\nfloat32 c"
PATHS = ("t", "g[0]", "g[1]", "g[2]", "c")
#: Encapsulation -> byte order and the largest alignment; None for ROS 1.
CODES = {None: ("<", 1), 0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}
HEADER = 12


def fields(text: str = TEXT, *, ros1: bool = True) -> tuple[Field, ...]:
    """Return the fields of a message."""
    return defined("pkg/M", text, ros1=ros1).fields()


def payload(row: int, code: int | None, text: bytes = b"imu\0") -> bytes:
    """Return a message: a stamp, a string, three numbers from 10 * row on, and a temperature."""
    order, align = CODES[code]
    body = struct.pack(order + "III", row, 5, len(text)) + text
    body += bytes(-len(body) % align)
    body += struct.pack(order + "dddf", *(10.0 * row + axis for axis in range(3)), row + 0.5)
    return body if code is None else struct.pack(">HH", code, 0) + body


def batch(*payloads: bytes, before: bytes = b"??") -> Batch:
    """Return messages with a few bytes between them; the last one ends with the buffer."""
    buffer, starts = bytearray(before), []
    for data in payloads:
        starts.append(len(buffer))
        buffer += data + b"HEAD"
    sizes = np.array([len(data) for data in payloads])
    return Batch(buffer[:-4], np.array(starts), sizes, 100 + np.arange(sizes.size))


def decoder(code: int | None = None) -> BinaryDecoder:
    """Return a decoder for one encapsulation."""
    return BinaryDecoder(fields(ros1=code is None), PATHS, ros1=code is None)


def check(found: Block, rows: Sequence[int]) -> None:
    """Compare samples with the messages of some rows."""
    log, stamps, *axes, temperature = found
    npt.assert_array_equal(log, 100 + np.arange(len(rows)))
    npt.assert_array_equal(stamps, [row * 10**9 + 5 for row in rows])
    npt.assert_array_equal(axes, [[10 * row + axis for row in rows] for axis in range(3)])
    npt.assert_array_equal(temperature, [row + 0.5 for row in rows])


@pytest.mark.parametrize("code", CODES)
def test_every_encapsulation_is_decoded(code: int | None) -> None:
    """A message can start at the first byte of the buffer."""
    for before in (b"??", b""):
        check(decoder(code).decode(batch(*(payload(row, code) for row in range(3)), before=before)), range(3))


@pytest.mark.parametrize("code", [None, 1])
@pytest.mark.parametrize("text", [b"IMU\0", b"x", b"longer than that"])
def test_a_string_of_another_length_shifts_the_next_fields(code: int | None, text: bytes) -> None:
    """A different string of the same length shifts nothing."""
    check(decoder(code).decode(batch(payload(0, code), payload(1, code, text), payload(2, code))), range(3))


def test_messages_outside_the_buffer_are_damaged() -> None:
    """The messages start before the buffer, or end one byte after it."""
    complete = batch(payload(0, 1), payload(1, 1))
    before = replace(complete, starts=np.array([complete.starts[0], -1]))
    for wrong in (before, replace(complete, buffer=bytes(complete.buffer[:-1]))):
        with pytest.raises(DamagedError, match=r"^a message extends beyond its chunk$"):
            decoder(1).decode(wrong)


@pytest.mark.parametrize("size", [8, 300])
def test_a_stamp_can_follow_a_string_of_any_length(size: int) -> None:
    found = fields("string s\ntime t\nfloat64[3] g", ros1=False)
    data = [
        struct.pack(">HH", 1, 0) + struct.pack("<I", size) + b"a" * size + struct.pack("<II", row, 5)
        for row in range(2)
    ]
    data = [
        item + bytes((4 - len(item)) % 8) + struct.pack("<3d", row, row, row) for row, item in enumerate(data)
    ]
    _, stamps, *_ = BinaryDecoder(found, PATHS[:-1], ros1=False).decode(batch(*data))
    npt.assert_array_equal(stamps, [5, 10**9 + 5])


def test_an_increment_divided_by_its_duration_is_a_rate() -> None:
    """The duration is in µs; a duration of zero gives no rate."""
    data = [struct.pack("<3fI", 1, 2, 3, micros) for micros in (500_000, 0)]
    one = BinaryDecoder(fields("float32[3] g\nuint32 dt"), ["g[0]/dt", "g[2]/dt"], ros1=True)
    log, *rates = one.decode(batch(*data))
    npt.assert_array_equal(log, [100, 101])
    npt.assert_array_equal(rates, [[2, np.nan], [6, np.nan]])


def test_encapsulations_can_alternate() -> None:
    """Each message is decoded by its own encapsulation, and the order is kept."""
    messages = batch(*(payload(row, code) for row, code in enumerate((1, 0, 7, 1, 6))))
    check(decoder(1).decode(messages), range(5))


@pytest.mark.parametrize("code", [None, 1])
def test_a_message_one_byte_too_short_is_damaged(code: int | None) -> None:
    with pytest.raises(DamagedError, match=r"^a message is shorter than its type$") as caught:
        decoder(code).decode(batch(payload(0, code), payload(1, code)[:-1]))
    assert caught.value.code == "damaged"


@pytest.mark.parametrize("code", [None, 1])
def test_messages_have_the_size_of_their_definition(code: int | None) -> None:
    """Up to three bytes are padding. If several messages are all longer, the definition is wrong."""
    data = [payload(row, code) for row in range(2)]
    check(decoder(code).decode(batch(data[0] + b"???", data[1])), range(2))
    longer = data[0] + b"more"
    cases = (((longer, longer), "definition"), ((longer, data[1]), "damaged"), ((longer,), "damaged"))
    for payloads, expected in cases:
        with pytest.raises(DamagedError, match=r"bytes instead of the \d+ of its definition$") as caught:
            decoder(code).decode(batch(*payloads))
        assert caught.value.code == expected


def test_fields_after_a_list_of_structures_can_have_any_size() -> None:
    """The definition does not determine the end of such a message."""
    found = fields(TEXT + "\nstring[] names", ros1=False)
    one = BinaryDecoder(found, PATHS, ros1=False)
    check(one.decode(batch(*(payload(row, 1) + b"more" * row for row in range(3)))), range(3))


def test_an_encapsulation_has_four_bytes() -> None:
    """A message of three bytes is too short. The error names an unknown encapsulation."""
    with pytest.raises(DamagedError, match=r"^a message is too short for CDR$"):
        decoder(1).decode(batch(b"\0\1\0"))
    with pytest.raises(DamagedError, match=r"extends beyond"):
        decoder(1).decode(batch(b"\0\1\0\0"))
    with pytest.raises(DamagedError) as caught:
        decoder(1).decode(batch(b"\0\x0a\0\0" + bytes(60)))
    assert (caught.value.code, str(caught.value)) == (
        "encapsulation",
        "encapsulation 0x000a is not supported; expected plain CDR or XCDR2",
    )


def test_a_string_longer_than_its_chunk_is_damaged() -> None:
    data = bytearray(payload(0, 1))
    struct.pack_into("<I", data, 12, 1 << 30)
    with pytest.raises(DamagedError, match=r"^s declares 1073741824 elements, more than its chunk contains$"):
        decoder(1).decode(batch(bytes(data)))


def test_sequences_have_the_size_of_their_elements() -> None:
    """Numbers of eight bytes are aligned; an empty sequence consists only of its length."""
    text = "float64[] v\ntime t\nfloat64[3] g"
    for code in (None, 1, 7):
        order, align = CODES[code]
        data = []
        for row, count in enumerate((2, 0, 1)):
            body = struct.pack(order + "I", count)
            if count:
                body += bytes(-len(body) % align) + bytes(8 * count)
            body += struct.pack(order + "II", row, 5)
            body += bytes(-len(body) % align) + struct.pack(
                order + "3d", *(10 * row + axis for axis in range(3))
            )
            data.append(body if code is None else struct.pack(">HH", code, 0) + body)
        one = BinaryDecoder(fields(text, ros1=code is None), PATHS[:-1], ros1=code is None)
        expected = np.array([[0, 1, 2], [10, 11, 12], [20, 21, 22]])
        npt.assert_array_equal(one.decode(batch(*data))[2:], expected.T)
        for row, item in enumerate(data):
            npt.assert_array_equal(one.decode(batch(item))[2:], expected[row][:, np.newaxis])


def test_seconds_are_signed_only_in_ros_2() -> None:
    """A ROS 1 stamp can be up to the year 2106, a ROS 2 stamp can be before 1970."""
    assert [field.code for field in fields("time t")] == ["u4", "u4"]
    assert [field.code for field in fields("builtin_interfaces/Time t", ros1=False)] == ["i4", "u4"]


def test_numbers_before_lists_of_strings_are_reachable() -> None:
    """Elements of arrays are reachable too. Strings and fields after such a list need the slow decoder."""
    assert is_reachable(PATHS, fields())
    for path, reached in (("c", True), ("g[2]", True), ("g[3]", False), ("s", False), ("none", False)):
        assert is_reachable([path], fields()) == reached

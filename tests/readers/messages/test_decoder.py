"""Messages to numbers, byte by byte: the fast way says no where a record differs, the slow one decodes it."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.testing as npt
import pytest

from imucal.readers.containers import Batch
from imucal.readers.files import DamagedError
from imucal.readers.messages.definitions import Field, defined
from imucal.readers.messages.message_types import ImuFields, Stamp, Vector
from imucal.readers.messages.plain import BinaryDecoder, Shape, is_reachable
from imucal.readers.store import Columns
from imucal.recording import Sensor

GYRO = Sensor.GYROSCOPE
TEXT = "time t\nstring s\nfloat64[3] g\nfloat32 c"
IMU = ImuFields(
    stamp=Stamp(sec="t.sec", nanosec="t.nanosec"),
    vectors=(Vector(sensor=GYRO, paths=("g",)),),
    temperature="c",
)
#: Encapsulation -> byte order and the largest alignment; None for ROS 1.
CODES = {None: ("<", 1), 0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}
HEADER = 12


def fields(text: str = TEXT, *, ros1: bool = True) -> tuple[Field, ...]:
    """Return the fields of a message."""
    return defined("pkg/M", text, ros1=ros1).fields()


def payload(row: int, code: int | None, text: bytes = b"imu\0") -> bytes:
    """Return one message: a stamp, a string, three numbers from 10 times its row on, and a temperature."""
    order, align = CODES[code]
    body = struct.pack(order + "III", row, 5, len(text)) + text
    body += bytes(-len(body) % align)
    body += struct.pack(order + "dddf", *(10.0 * row + axis for axis in range(3)), row + 0.5)
    return body if code is None else struct.pack(">HH", code, 0) + body


@dataclass(frozen=True, kw_only=True)
class Log:
    """Records of four bytes that are alike, a log time of eight, and a payload."""

    payloads: Sequence[bytes]
    before: bytes = b"??"
    mark: bytes = b"HEAD"

    def batch(self, **changes: object) -> Batch:
        """Return them as a batch."""
        buffer, starts = bytearray(self.before), []
        for row, data in enumerate(self.payloads):
            starts.append(len(buffer))
            buffer += (self.mark if row else b"HEAD") + struct.pack("<q", 100 + row) + data
        whole = Batch(
            buffer=buffer,
            starts=np.array(starts),
            header=HEADER,
            sizes=len(self.payloads[0]),
            log_ns=np.zeros(0, dtype=np.int64),
            log_at=4,
            guards=((0, b"HEAD"),),
        )
        return replace(whole, **changes)  # type: ignore[arg-type]

    def checked(self) -> Batch:
        """Return them as a batch whose records were looked at."""
        sizes = np.array([len(data) for data in self.payloads])
        log = 100 + np.arange(sizes.size)
        return Batch.of(self.batch().buffer, self.batch().starts, sizes, log, header=HEADER)


def decoder(code: int | None = None, *more: Shape, exact: bool = False) -> BinaryDecoder:
    """Return a decoder of the messages of one encapsulation."""
    ros1 = code is None
    return BinaryDecoder([*more, Shape(fields(ros1=ros1), IMU)], ros1=ros1, exact=exact)


def columns(n: int) -> Columns:
    """Return columns with two rows of room around `n` messages, all of them -1."""
    room = Columns(n + 4, (GYRO,), temperature=True)
    for row in (room.log, room.stamps, room.vectors[GYRO], room.temperature):
        assert row is not None
        row[...] = -1
    return room


def check(found: Columns, rows: Sequence[int]) -> None:
    """Compare columns with the messages of some rows; nothing else was written."""
    to = slice(2, 2 + len(rows))
    npt.assert_array_equal(found.log[to], 100 + np.arange(len(rows)))
    npt.assert_array_equal(found.stamps[to], [row * 10**9 + 5 for row in rows])
    npt.assert_array_equal(
        found.vectors[GYRO][:, to], [[10 * row + axis for row in rows] for axis in range(3)]
    )
    assert found.temperature is not None
    npt.assert_array_equal(found.temperature[to], [row + 0.5 for row in rows])
    for outside in (slice(2), slice(2 + len(rows), None)):
        for row in (found.log, found.stamps, found.vectors[GYRO], found.temperature):
            assert (row[..., outside] == -1).all()


@pytest.mark.parametrize("code", CODES)
def test_both_ways_decode_the_same(code: int | None) -> None:
    """In every encapsulation, with its byte order and alignment; the last record ends with the buffer."""
    log = Log(payloads=[payload(row, code) for row in range(3)])
    found = columns(3)
    assert decoder(code).fast(log.batch(), found, 2)
    check(found, range(3))
    found = columns(3)
    decoder(code).slow(log.checked(), found, 2)
    check(found, range(3))


@pytest.mark.parametrize("code", [None, 1])
@pytest.mark.parametrize("text", [b"IMU\0", b"x", b"longer than that"])
def test_a_string_of_another_length_is_seen(code: int | None, text: bytes) -> None:
    """It shifts what follows: one of the same length does not."""
    log = Log(payloads=[payload(0, code), payload(1, code, text), payload(2, code)])
    found = columns(3)
    assert decoder(code).fast(log.batch(), found, 2) == (len(text) == 4)
    found = columns(3)
    decoder(code).slow(log.checked(), found, 2)
    check(found, range(3))


@pytest.mark.parametrize(
    "log",
    [
        Log(payloads=[payload(0, 1), payload(1, 1)], mark=b"HEAR"),
        Log(payloads=[payload(0, 1), payload(1, 0)]),
        Log(payloads=[b"\0\2" + payload(row, 1)[2:] for row in range(2)]),
        Log(payloads=[payload(0, 1), payload(1, 1)[:-1]]),
    ],
    ids=["head", "encapsulation", "unknown", "cut"],
)
def test_a_record_that_differs_is_not_decoded_at_once(log: Log) -> None:
    """In its head, its encapsulation, or that it is not whole."""
    assert not decoder(1).fast(log.batch(), columns(2), 2)


def test_places_outside_the_buffer_are_not_read() -> None:
    """Before it, or beyond it by one byte; such a record is found when it is checked."""
    log = Log(payloads=[payload(0, 1), payload(1, 1)])
    starts = log.batch().starts
    for wrong in ([starts[0], -1], [starts[0], starts[1] + 1]):
        assert not decoder(1).fast(log.batch(starts=np.array(wrong)), columns(2), 2)
    assert not decoder(1).fast(log.batch(sizes=7), columns(2), 2)


def test_the_first_byte_of_the_buffer_may_begin_a_record() -> None:
    log = Log(payloads=[payload(0, 1)], before=b"")
    found = columns(1)
    assert decoder(1).fast(log.batch(), found, 2)
    check(found, range(1))


def test_records_of_many_sizes_go_the_slow_way() -> None:
    """Nothing says that they are alike; those without guards were checked."""
    log = Log(payloads=[payload(0, 1), payload(1, 1)])
    assert not decoder(1).fast(log.batch(sizes=np.array([44, 44])), columns(2), 2)
    found = columns(2)
    assert decoder(1).fast(log.batch(guards=()), found, 2)
    check(found, range(2))
    other = Log(payloads=[payload(0, 1), payload(1, 1, b"x")])
    assert not decoder(1).fast(other.batch(guards=()), columns(2), 2)


def test_a_first_message_that_claims_too_much_is_left_to_the_slow_way() -> None:
    """Its string is longer than the chunk: that is found, and told, message by message."""
    log = Log(payloads=[payload(0, 1), payload(1, 1)])
    batch = log.batch()
    first = int(batch.payload()[0]) + 4
    data = bytes(batch.buffer)
    at = first + data[first:].index(b"\x04\0\0\0")
    broken = replace(batch, buffer=bytearray(data[:at] + b"\xff\xff\xff\x7f" + data[at + 4 :]))
    assert not decoder(1).fast(broken, columns(2), 2)


def test_what_was_learnt_from_one_chunk_is_learnt_again_where_the_next_differs() -> None:
    """Its guards or its size say so: strings may be longer there, for good."""
    one, other = (
        Log(payloads=[payload(row, 1, text) for row in range(2)]) for text in (b"a\0", b"long\0" * 4)
    )
    both = decoder(1)
    for batch in (one.batch(), other.batch(), other.batch(guards=((0, b"HE"),)), one.batch()):
        assert both.fast(batch, columns(2), 2)
    found = columns(2)
    assert both.fast(other.batch(guards=()), found, 2)
    check(found, range(2))


@pytest.mark.parametrize(("size", "fast"), [(256 - HEADER - 4 - 4 - 8, True), (256 - HEADER - 4 - 4, False)])
def test_a_stamp_far_behind_is_read_the_slow_way(size: int, fast: bool) -> None:  # noqa: FBT001
    """Within the first 256 bytes of a record it is read at once."""
    found = fields("string s\ntime t\nfloat64[3] g", ros1=False)
    imu = replace(IMU, temperature="")
    data = [
        struct.pack(">HH", 1, 0) + struct.pack("<I", size) + b"a" * size + struct.pack("<II", row, 5)
        for row in range(2)
    ]
    data = [
        item + bytes((4 - len(item)) % 8) + struct.pack("<3d", row, row, row) for row, item in enumerate(data)
    ]
    one = BinaryDecoder([Shape(found, imu)], ros1=False)
    room = Columns(2, (GYRO,), temperature=False)
    assert one.fast(Log(payloads=data).batch(), room, 0) == fast
    if fast:
        npt.assert_array_equal(room.stamps, [5, 10**9 + 5])


def test_a_message_without_a_stamp_has_none_and_a_count_is_in_microseconds() -> None:
    """Zero, which no clock shows; the log's own time is there."""
    log = Log(payloads=[struct.pack("<Q3d", 7 + row, 1, 2, 3) for row in range(2)])
    for stamp, expected in (
        (None, [0, 0]),
        (Stamp(sec="t"), [7000, 8000]),
        (Stamp(sec="t", scale=1), [7, 8]),
    ):
        imu = replace(IMU, stamp=stamp, temperature="")
        one = BinaryDecoder([Shape(fields("uint64 t\nfloat64[3] g"), imu)], ros1=True)
        for fast in (True, False):
            room = Columns(2, (GYRO,), temperature=False)
            room.stamps[:] = -1
            if fast:
                assert one.fast(log.batch(), room, 0)
            else:
                one.slow(log.checked(), room, 0)
            npt.assert_array_equal(room.stamps, expected)
            npt.assert_array_equal(room.log, [100, 101])


def test_log_times_may_lie_apart_from_the_records() -> None:
    """As those of an index do."""
    log = Log(payloads=[payload(0, 1), payload(1, 1)])
    found = columns(2)
    assert decoder(1).fast(log.batch(log_at=None, log_ns=np.array([100, 101])), found, 2)
    check(found, range(2))


def test_encapsulations_may_take_turns() -> None:
    """Each message is decoded by its own, and stays in its place."""
    log = Log(payloads=[payload(row, code) for row, code in enumerate((1, 0, 7, 1, 6))])
    found = columns(5)
    decoder(1).slow(log.checked(), found, 2)
    check(found, range(5))


@pytest.mark.parametrize("code", [None, 1])
def test_a_message_that_is_shorter_than_its_type_is_damaged(code: int | None) -> None:
    """By a byte; one that is longer may hold more than is wanted."""
    log = Log(payloads=[payload(0, code) + b"more", payload(1, code)])
    found = columns(2)
    decoder(code).slow(log.checked(), found, 2)
    check(found, range(2))
    log = Log(payloads=[payload(0, code), payload(1, code)[:-1]])
    with pytest.raises(DamagedError, match=r"^a message is shorter than its type$") as caught:
        decoder(code).slow(log.checked(), columns(2), 2)
    assert caught.value.code == "damaged"


def test_an_encapsulation_takes_four_bytes() -> None:
    """A message of three has none; one of another kind is named."""
    with pytest.raises(DamagedError, match=r"^a message is too short for CDR$"):
        decoder(1).slow(Log(payloads=[b"\0\1\0"]).checked(), columns(1), 2)
    with pytest.raises(DamagedError, match=r"^a message is shorter than its type$|extends beyond"):
        decoder(1).slow(Log(payloads=[b"\0\1\0\0"]).checked(), columns(1), 2)
    with pytest.raises(DamagedError) as caught:
        decoder(1).slow(Log(payloads=[b"\0\x0a\0\0" + bytes(60)]).checked(), columns(1), 2)
    assert (caught.value.code, str(caught.value)) == (
        "encapsulation",
        "encapsulation 0x000a is not supported; expected plain CDR or XCDR2",
    )
    decoder(1).slow(Log(payloads=[payload(0, 1)]).checked().part(np.arange(0)), columns(0), 2)


OTHER = "time t\nstring s\nfloat64[3] g\nfloat32 c\nuint32 more"
USED = "the definition in the log does not match its messages; the standard one was used"


@pytest.mark.parametrize(
    ("code", "padding", "text", "used"),
    [
        (None, 0, OTHER, True),
        (None, 0, TEXT, False),
        (None, 1, TEXT, False),
        (1, 3, TEXT, False),
        (1, 0, OTHER, True),
        (1, 0, TEXT + "\nstring[] names", False),
    ],
)
def test_the_definition_that_fits_the_size_is_used(
    code: int | None,
    padding: int,
    text: str,
    used: bool,  # noqa: FBT001
) -> None:
    """A byte is spare in ROS 1, three in CDR; a layout that is not known to its end is not judged. Once."""
    log = Log(payloads=[payload(row, code) + bytes(padding) for row in range(2)])
    own = Shape(fields(text, ros1=code is None), IMU)
    both = decoder(code, own)
    assert both.walker.fields == own.fields[: len(both.walker.fields)]
    both.settle(log.checked())
    both.settle(log.checked())
    assert [(note.code, note.text) for note in both.notes] == ([("definition", USED)] if used else [])


@pytest.mark.parametrize(("code", "padding"), [(None, 2), (1, 4)])
def test_more_spare_bytes_are_another_definition(code: int | None, padding: int) -> None:
    """The standard one is not used either unless it fits."""
    log = Log(payloads=[payload(row, code) + bytes(padding) for row in range(2)])
    more = "\nuint8[2] more" if code is None else "\nuint32 more"
    shapes = [Shape(fields(TEXT + extra, ros1=code is None), IMU) for extra in ("", more)]
    for order, notes in ((shapes, 1), (shapes[:1], 0), (shapes[::-1], 0), ([shapes[0]] * 2, 0)):
        both = BinaryDecoder(order, ros1=code is None)
        both.settle(log.checked())
        assert len(both.notes) == notes


def test_a_definition_that_is_assumed_must_fit_exactly() -> None:
    """But for the padding of CDR: up to three bytes; such messages are never decoded at once."""
    one = decoder(1, exact=True)
    for more, fits in ((0, True), (3, True), (4, False)):
        log = Log(payloads=[payload(row, 1) + bytes(more) for row in range(2)])
        assert not one.fast(log.batch(), columns(2), 2)
        if fits:
            one.slow(log.checked(), columns(2), 2)
        else:
            with pytest.raises(DamagedError, match="do not have the size of the built-in") as caught:
                one.slow(log.checked(), columns(2), 2)
            assert caught.value.code == "definition"


def test_a_string_can_not_be_longer_than_its_chunk() -> None:
    """Its length is what is damaged."""
    data = bytearray(payload(0, 1))
    struct.pack_into("<I", data, 12, 1 << 30)
    with pytest.raises(DamagedError, match=r"^s declares 1073741824 elements, more than its chunk contains$"):
        decoder(1).slow(Log(payloads=[bytes(data)]).checked(), columns(1), 2)


def test_sequences_take_the_room_of_their_elements() -> None:
    """Numbers of eight bytes are aligned where there are any; of an empty one only its length is there."""
    text = "float64[] v\ntime t\nfloat64[3] g"
    imu = replace(IMU, temperature="")
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
        one = BinaryDecoder([Shape(fields(text, ros1=code is None), imu)], ros1=code is None)
        room = Columns(3, (GYRO,), temperature=False)
        one.slow(Log(payloads=data).checked(), room, 0)
        npt.assert_array_equal(room.vectors[GYRO].T, [[0, 1, 2], [10, 11, 12], [20, 21, 22]])
        for row, item in enumerate(data):
            one.slow(Log(payloads=[item]).checked(), room, row)
        npt.assert_array_equal(room.vectors[GYRO].T, [[0, 1, 2], [10, 11, 12], [20, 21, 22]])


def test_seconds_are_signed_in_ros_2_alone() -> None:
    """A ROS 1 stamp reaches to the year 2106, a ROS 2 one before 1970."""
    assert [field.code for field in fields("time t")] == ["u4", "u4"]
    assert [field.code for field in fields("builtin_interfaces/Time t", ros1=False)] == ["i4", "u4"]


def test_numbers_before_lists_of_texts_are_reached_by_steps() -> None:
    """So are elements of arrays; a text, and what stands behind such a list, take another way."""
    spread = Vector(sensor=GYRO, paths=("g[0]", "g[1]", "g[2]"))
    assert is_reachable(replace(IMU, vectors=(spread,)), fields())
    for path, reached in (("c", True), ("g[2]", True), ("g[3]", False), ("s", False), ("none", False)):
        assert is_reachable(replace(IMU, vectors=(), temperature=path), fields()) == reached

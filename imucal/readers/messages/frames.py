"""The frame of a topic: the `frame_id` that the header of its first message states."""

from collections.abc import Iterator, Sequence

from imucal.readers.containers import Channel, Container
from imucal.readers.containers.container import Batch
from imucal.readers.files import DamagedError, Scratch
from imucal.readers.messages.choice import Choice
from imucal.readers.messages.topics import Topic

#: Bytes of a ROS 1 header, and of a ROS 2 header with its encapsulation, before the frame's length.
_BEFORE = {"ros1": 12, "cdr": 12}
#: A longer name is a damaged one.
_LONGEST = 256


def first_frames(containers: Sequence[Container], choices: Sequence[Choice]) -> list[tuple[str, str]]:
    """Return the frames of what was chosen as decisions of a recording; none of a topic without a frame."""
    frames = (first_frame(containers, choice.topic) for choice in choices)
    return [("frame", frame) for frame in frames if frame]


def first_frame(containers: Sequence[Container], topic: Topic) -> str:
    """Return the frame of a topic's first message; empty where its messages have no header, or no name.

    Nothing is taken on trust: what can't be a name is none.
    """
    if topic.imu is None or topic.imu.stamp is None or not topic.imu.stamp.sec.startswith("header."):
        return ""
    for number, channel in topic.channels:
        for payload in _first_payload(containers[number], channel):
            return _frame(payload, channel.encoding)
    return ""


def _first_payload(container: Container, channel: Channel) -> Iterator[bytes]:
    """Yield the start of the first message of a channel that can be read, if there is one."""
    scratch = Scratch()
    for task in container.tasks(frozenset([channel.key])):
        try:
            for key, batch in task.load(scratch):
                checked = batch.checked() if key == channel.key else batch
                if key == channel.key and checked.n:
                    yield _start(checked)
                    return
        except DamagedError:
            continue


def _start(batch: Batch) -> bytes:
    first = int(batch.payload()[0])
    size = batch.sizes if isinstance(batch.sizes, int) else int(batch.sizes[0])
    return bytes(memoryview(batch.buffer)[first : first + min(size, _BEFORE["cdr"] + 4 + _LONGEST)])


def _frame(payload: bytes, encoding: str) -> str:
    before = _BEFORE.get(encoding)
    if before is None or len(payload) < before + 4:
        return ""
    # ROS 1 is little endian; CDR says which it is in the second byte of its encapsulation.
    order = "little" if encoding == "ros1" or payload[1] & 1 else "big"
    length = int.from_bytes(payload[before : before + 4], order)  # type: ignore[arg-type]
    name = payload[before + 4 : before + 4 + length].rstrip(b"\x00")
    if not 0 < length <= _LONGEST or before + 4 + length > len(payload):
        return ""
    text = name.decode("utf-8", "replace")
    return text if text.isprintable() else ""

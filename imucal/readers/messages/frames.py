"""Read the frame in a message header."""

#: Bytes before the frame's length in a ROS 1 header, or a ROS 2 header with encapsulation.
_BEFORE = 12
#: A longer frame name is damage.
_MAX_FRAME_BYTES = 256


def frame_of(message: bytes, encoding: str) -> str:
    """Return the frame in a message header; empty if its bytes can't be a name."""
    if encoding not in {"ros1", "cdr"} or len(message) < _BEFORE + 4:
        return ""
    # CDR: the second byte of the encapsulation contains the byte order.
    little = encoding == "ros1" or message[1] & 1
    end = _BEFORE + 4 + int.from_bytes(message[_BEFORE : _BEFORE + 4], "little" if little else "big")
    name = message[_BEFORE + 4 : end].rstrip(b"\x00")
    if not 0 < end - _BEFORE - 4 <= _MAX_FRAME_BYTES or end > len(message):
        return ""
    text = name.decode("utf-8", "replace")
    return text if text.isprintable() else ""

"""VectorNav ASCII messages with raw samples: ``$VNYMR`` and ``$VNIMU``, checksums checked.

Source: VectorNav VN-100 user manual UM001, registers 27 and 54; accelerations in m/s^2, rates in rad/s.
"""

import re
from collections.abc import Sequence

import numpy as np

from imucal.readers.tables.layout import Layout, is_number, split_line

#: Message -> names of its fields.
_FIELDS: dict[str, tuple[str, ...]] = {
    "VNYMR": (
        *("$VNYMR", "yaw", "pitch", "roll", "MagX", "MagY", "MagZ"),
        *("AccelX", "AccelY", "AccelZ", "GyroX", "GyroY", "GyroZ"),
    ),
    "VNIMU": (
        *("$VNIMU", "MagX", "MagY", "MagZ", "AccelX", "AccelY", "AccelZ"),
        *("GyroX", "GyroY", "GyroZ", "Temp", "Pressure"),
    ),
}

_SENTENCE = re.compile(r"\$(?P<name>VNYMR|VNIMU),")

#: What stands before a sentence, the sentence, and its checksum of two or four digits.
_CHECKED = re.compile(
    rb"(?m)^([^$\n]*)\$((?:VNYMR|VNIMU),[^*\n]*)\*([0-9A-Fa-f]{2})(?:[0-9A-Fa-f]{2})?[ \t]*$"
)


def find_vectornav(lines: Sequence[str]) -> Layout | None:
    """Return the layout of a log of VectorNav messages; None where there are none.

    What stands in front of a message, such as the time of the computer that logged it, comes first.
    """
    matches = [(line, match) for line in lines if (match := _SENTENCE.search(line))]
    if len(matches) < 0.3 * sum(bool(line.strip()) for line in lines) or not matches:
        return None
    name = matches[0][1]["name"]
    before = split_line(matches[0][0][: matches[0][1].start()].rstrip(", \t"), ",")
    before = before if any(before) else []
    names = ["host time" if len(before) == 1 else f"prefix {i}" for i in range(len(before))]
    headers = (*names, *_FIELDS[name])
    rows = []
    for line, match in matches:
        cells = split_line(line.partition("*")[0], ",")
        if match["name"] == name and len(cells) == len(headers) and is_number(cells[-1]):
            rows.append(tuple(cells))
    if not rows:
        return None
    return Layout(
        delimiter=",",
        decimal=".",
        width=len(headers),
        headers=headers,
        units=(),
        preamble=(),
        start=0,
        rows=tuple(rows),
    )


def good_sentences(block: bytes) -> bytes:
    """Return the messages of a block whose checksum is right, as rows of cells.

    A message with a wrong checksum stays as a row that no parser takes, so that it is counted.
    """
    lines = []
    for match in _CHECKED.finditer(block):
        before, sentence, checksum = match.groups()
        right = int(np.bitwise_xor.reduce(np.frombuffer(sentence, dtype=np.uint8))) == int(checksum, 16)
        lines.append(before + b"$" + sentence if right else b"wrong checksum")
    return b"\n".join(lines) + b"\n"

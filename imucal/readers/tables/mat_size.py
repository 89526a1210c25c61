"""How much a MATLAB file unpacks to, without keeping any of it.

Source: MathWorks, MAT-File Format (version 5): a header of 128 bytes, then elements of a tag of 8 bytes (type
and size) and their data; those of type 15 are zlib streams.
"""

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

_HEADER, _COMPRESSED = 128, 15
#: No zlib stream grows by more than this factor. Source: zlib, "Maximum compression factor".
MOST_GROWTH = 1032
#: Bytes unpacked at once.
_PIECE = 1 << 20


def unpacks_to_more(path: Path, limit: int) -> bool:
    """Return whether the elements of a file hold more than `limit` bytes together."""
    size = path.stat().st_size
    if size * MOST_GROWTH <= limit:
        return False
    total = 0
    with path.open("rb") as file:
        file.seek(124)
        order = ">" if file.read(4)[2:] == b"MI" else "<"
        while len(tag := file.read(8)) == 8 and total <= limit:
            kind, length = struct.unpack(f"{order}II", tag)
            length = min(length, size - file.tell())
            if kind == _COMPRESSED:
                total += _unpacked(file, length, limit - total)
            else:
                total += length
                file.seek(length, 1)
    return total > limit


def _unpacked(file: BinaryIO, length: int, limit: int) -> int:
    """Return how many bytes a stream holds, or a number beyond `limit`; a damaged one as far as it goes."""
    machine, total = zlib.decompressobj(), 0
    end = file.tell() + length
    try:
        while total <= limit and not machine.eof:
            packed = machine.unconsumed_tail or file.read(min(_PIECE >> 6, end - file.tell()))
            if not packed:
                break
            total += len(machine.decompress(packed, _PIECE))
    except zlib.error:
        pass
    file.seek(end)
    return total

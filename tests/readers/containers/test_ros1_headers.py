"""Headers of messages are compared with the last one: all bytes except the time and the size."""

import numpy as np
import pytest

from imucal.readers.containers.ros1 import _alike


@pytest.mark.parametrize("free", [range(9, 17), range(0)])
def test_each_byte_but_the_time_and_the_size_counts(free: range) -> None:
    """A header without a time is compared whole."""
    head = (b"0123time=12345678abc" if free else b"op=2 and more") + b"SIZE"
    changed = [head]
    for at in range(len(head)):
        other = bytearray(head)
        other[at] ^= 1
        changed.append(bytes(other))
    same = _alike(np.array(changed, f"V{len(head)}"), head)
    counts = [at not in free and at < len(head) - 4 for at in range(len(head))]
    assert same.tolist() == [True] + [not count for count in counts]

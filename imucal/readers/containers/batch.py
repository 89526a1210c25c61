"""The messages of one channel in one chunk, as positions in its bytes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucal.arrays import IntArray
from imucal.readers.messages.walker import Bytes

#: A position from the start of a record, a NumPy type, and the number that every record has there.
Guard = tuple[int, str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """A part of a log that could not be read as it should: the finding's code, why, and messages lost."""

    code: str
    text: str
    messages: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Batch:
    """Messages of one channel.

    Attributes
    ----------
    buffer
        What they lie in; valid until the next chunk is loaded by the same thread.
    starts
        Where each record starts, shape (n,).
    header
        Bytes of a record before its payload.
    sizes
        Bytes of the payload: one for all messages, or one for each, shape (n,).
    log_ns
        When each was recorded, shape (n,), in ns; empty where `log_at` tells.
    log_at
        Where in a record that time stands as eight bytes, or None.
    guards
        What must be true of every record for `header` and `sizes` to hold; empty where it was checked.
    check
        Returns the same messages with every record checked on its own; raises DamagedError.
    loss
        What was found wrong while checking.
    """

    buffer: Bytes
    starts: IntArray
    header: int
    sizes: IntArray | int
    log_ns: IntArray
    log_at: int | None = None
    guards: tuple[Guard, ...] = ()
    check: Callable[[], "Batch"] | None = None
    loss: Loss | None = None

    @property
    def n(self) -> int:
        """Number of messages."""
        return self.starts.size

    def checked(self) -> "Batch":
        """Return a batch whose positions and sizes were checked record by record."""
        return self.check() if self.check is not None else self

    def part(self, chosen: IntArray) -> "Batch":
        """Return some messages of a checked batch."""
        sizes = self.sizes if isinstance(self.sizes, int) else self.sizes[chosen]
        return Batch(
            buffer=self.buffer,
            starts=self.starts[chosen],
            header=self.header,
            sizes=sizes,
            log_ns=self.log_ns[chosen],
        )

    def payload(self) -> IntArray:
        """Return where each payload starts, shape (n,)."""
        return self.starts + np.int64(self.header)

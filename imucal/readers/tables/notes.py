"""What a file of arrays contains besides its arrays, and why it is refused."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np


class RefusedError(Exception):
    """A file that imucal does not read; the text is the reason with advice. Caught in the child."""


@dataclass
class Notes:
    """What a file contains in addition to its arrays."""

    #: Objects that only MATLAB or Python reads: name -> class.
    objects: dict[str, str] = field(default_factory=dict)
    #: Arrays of types that can't be samples, such as ``gyro (900,) complex128``.
    skipped: list[str] = field(default_factory=list)
    #: The contradiction in a damaged file; empty if there is none.
    damage: str = ""
    #: Why the file is refused; empty if it is read.
    refusal: str = ""

    def skip(self, name: str, shape: Sequence[int], dtype: np.dtype[Any]) -> None:
        """Add an array of an unsuitable type."""
        self.skipped.append(f"{name} {(*shape,)} {dtype.name}")

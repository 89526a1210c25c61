"""Refuse samples that do not fit into memory: the system would end the process without a message."""

from imucal.errors import DataError, Fix
from imucal.resources import memory_there_is

#: Largest share of the memory for the columns of a log; the analysis needs the rest.
_SHARE = 0.6
#: Bytes of a value.
_VALUE = 8


def fit_into_memory(values: int) -> bool:
    """Return whether so many values of columns fit into memory, or if its size is unknown."""
    there = memory_there_is()
    return there is None or _VALUE * values <= _SHARE * there


def too_large(place: object, values: int, *fixes: Fix) -> DataError:
    """Return the error for columns with too many values."""
    there = memory_there_is() or 0
    needed, has = _VALUE * values / 1e9, there / 1e9
    text = (
        f"its samples need {needed:.3g} GB of memory, and this machine has {has:.3g} GB, of which the "
        "analysis needs a part; expected a shorter log, or a larger machine"
    )
    return DataError(text, place=place, fixes=fixes)

"""The columns of one sensor as read, before clocks and units."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from imucal.arrays import BoolArray, FloatArray
from imucal.readers.tables.plan import SensorPlan
from imucal.readers.tables.stamps import Numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorRows:
    """The columns of one sensor, shape (n,) each, in units of the log.

    Attributes
    ----------
    place
        Place in errors.
    table
        Name of the table; `is_topic` as in `imucal.readers.table.Table`.
    rate_hz
        Sampling rate in the file, in Hz.
    source
        Name of the clock; empty for a column of a file.
    sparse
        Whether rows without values belong to other sensors.
    rows_left
        Hash of the mask of kept rows; empty if all are kept.
    compared
        Rows are duplicates if all of these values repeat; None for the axes.
    """

    plan: SensorPlan
    axes: Sequence[FloatArray]
    time: Sequence[Numbers] = ()
    log_time: Sequence[Numbers] = ()
    temperature: FloatArray | None = None
    place: str = ""
    table: str = ""
    is_topic: bool = False
    rate_hz: float | None = None
    source: str = ""
    sparse: bool = False
    rows_left: bytes = b""
    compared: Sequence[FloatArray] | None = None

    @property
    def n(self) -> int:
        return self.axes[0].size

    def where(self, keep: BoolArray, rows_left: bytes) -> "SensorRows":
        """Return the rows where `keep` is true."""

        def kept(columns: Sequence[Any]) -> list[Any]:
            return [column[keep] for column in columns]

        return replace(
            self,
            axes=kept(self.axes),
            time=kept(self.time),
            log_time=kept(self.log_time),
            temperature=None if self.temperature is None else self.temperature[keep],
            compared=None if self.compared is None else kept(self.compared),
            rows_left=rows_left,
        )

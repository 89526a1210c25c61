"""Correct messages in place: numbers of fixed size, at places that the message type determines."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.calibration.applying import Correction, without_force
from imucal.correction.bias_over_time import BiasOverTime
from imucal.correction.targets import Target
from imucal.errors import DataError, Fix
from imucal.readers.containers.container import Batch
from imucal.readers.message_logs import MessageLog
from imucal.readers.messages.plain import BinaryDecoder
from imucal.readers.table import Request, Table
from imucal.readers.tables.stamps import TimeChoice
from imucal.recording import Sensor

if TYPE_CHECKING:
    from imucal.readers.messages.loader import Decoder


class MessageCorrection:
    """Corrects the messages of a log.

    `patch(container)` returns the function that changes a batch of messages of a channel. If the gyroscope
    has g-sensitivity and its own topic, the force is interpolated at the times of its messages.
    """

    def __init__(
        self, log: MessageLog, targets: Sequence[Target], correction: Correction | BiasOverTime
    ) -> None:
        self._log = log
        self._correction = correction
        self._own: dict[Table, dict[Sensor, Target]] = {}
        for target in targets:
            self._own.setdefault(target.table, {})[target.sensor] = target
        apart = not any(len(own) == len(Sensor) for own in self._own.values())
        #: Decoders of the samples and of the times of a channel, and its sensors.
        self._channels: dict[tuple[int, int], tuple[BinaryDecoder, Decoder | None, dict[Sensor, Target]]] = {}
        self._force: tuple[FloatArray, FloatArray] | None = None
        over_time = isinstance(correction, BiasOverTime)
        interpolated = isinstance(correction, Correction) and bool(correction.G.any()) and apart
        for table, own in self._own.items():
            self._add(table, own, timed=interpolated or over_time)
        if isinstance(correction, Correction) and interpolated:
            self._force = self._forces(targets, correction)

    def _add(self, table: Table, own: dict[Sensor, Target], *, timed: bool) -> None:
        indices = [index for target in own.values() for index in target.indices]
        for number in self._log.numbers_of(table, indices):
            if not number.type.startswith(("float", "double")) or "/" in number.path:
                problem = f"{number.name} of topic {table.name} is {number.type}, which can't hold its value"
                fix = Fix("convert the log to a format with floating-point numbers, such as CSV")
                raise DataError(problem, place=self._log.name, fix=fix)
        times: dict[tuple[int, int], Decoder] = {}
        stamp = _stamp(own)
        if timed and stamp is not None:
            times = dict(self._log.stream_of(table, [stamp]).decoders)
        for place, decoder in self._log.stream_of(table, indices).decoders.items():
            if not isinstance(decoder, BinaryDecoder):
                problem = f"topic {table.name} has messages without a fixed layout (JSON or protobuf)"
                raise DataError(problem, place=self._log.name, fix=Fix("convert the log to ROS messages"))
            self._channels[place] = decoder, times.get(place), own

    def _forces(self, targets: Sequence[Target], correction: Correction) -> tuple[FloatArray, FloatArray]:
        """Return the times in ns, shape (n,), and the corrected specific force, shape (n, 3), of the log."""
        target = next((one for one in targets if one.sensor is Sensor.ACCELEROMETER), None)
        if target is None:
            raise without_force(self._log.name)
        stamp = _stamp({target.sensor: target})
        times = () if stamp is None else (TimeChoice(kind="ns", indices=(stamp,), name=""),)
        (data,) = self._log.read([Request(table=target.table, samples=target.indices, times=times)])
        column = data.columns[target.table.log_time or 0] if stamp is None else data.columns[stamp]
        raw = np.column_stack([data.columns[index] for index in target.indices]).astype(np.float64)
        order = np.argsort(column, kind="stable")
        force = correction.force(raw[order] * target.factor)
        known = np.isfinite(force).all(axis=1)
        return np.asarray(column[order][known], np.float64), force[known]

    def keys(self, container: int) -> frozenset[int]:
        """Return the channels of a file whose messages change."""
        return frozenset(key for number, key in self._channels if number == container)

    def patch(self, container: int, key: int, batch: Batch) -> None:
        """Correct a batch of messages of a channel, whose buffer is mutable."""
        decoder, timer, own = self._channels[container, key]
        columns = decoder.decode(batch)[1:]
        raw = {
            sensor: np.column_stack(columns[3 * place : 3 * place + 3]).astype(np.float64) * target.factor
            for place, (sensor, target) in enumerate(own.items())
        }
        times = batch.log_ns if timer is None else timer.decode(batch)[1]
        corrected = self._corrected(raw, np.asarray(times, np.int64))
        decoder.write(
            batch,
            [column for sensor, target in own.items() for column in (corrected[sensor] / target.result).T],
        )

    def _corrected(self, raw: dict[Sensor, FloatArray], times: IntArray) -> dict[Sensor, FloatArray]:
        if isinstance(self._correction, BiasOverTime):
            return self._correction.samples(raw, times)
        force = None
        if self._force is not None and Sensor.GYROSCOPE in raw:
            known, forces = self._force
            force = np.column_stack(
                [np.interp(times.astype(np.float64), known, column) for column in forces.T]
            )
        return self._correction.samples(raw, force)


def _stamp(own: dict[Sensor, Target]) -> int | None:
    """Return the column of complete stamps in messages; None if only the log has times."""
    times = {target.time for target in own.values()}
    time = times.pop() if len(times) == 1 else None
    return time.indices[0] if time is not None and time.kind == "ns" and len(time.indices) == 1 else None

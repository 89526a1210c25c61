"""Logs of flight controllers: PX4's ULog (pyulog) and ArduPilot's ``.bin`` (pymavlink, an extra).

Both packages may loop forever on a damaged file, so they run in a child process. Each instance of a message
is a topic. PX4's ``_fifo`` messages contain every sample of a buffer. Sources: PX4's message definitions;
`AP_InertialSensor/LogStructure.h`.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.findings import Finding
from imucal.readers.containers.container import gather
from imucal.readers.files import first_bytes
from imucal.readers.isolation import isolated, require
from imucal.readers.messages.plain import quotient
from imucal.readers.read_options import ReadOptions
from imucal.readers.table import HEAD_ROWS, STAMPS, Column, Table
from imucal.readers.tables.column_log import ColumnLog
from imucal.readers.tables.dialects import Dialect
from imucal.readers.ulog_walk import walk
from imucal.recording import AXES

#: Signature of a ULog.
ULOG = b"ULog\x01\x12\x35"

#: Field -> values, shape (n,) each.
Fields: TypeAlias = Mapping[str, NDArray[Any]]

#: Slower instances are health checks, not recordings.
_MIN_RATE_SHARE = 0.2
#: Later stamps are damaged: about 140 years, in microseconds.
_MAX_STAMP_US = 1 << 52
#: Bytes of an unfinished page at the end, which is no damage.
_MAX_PAGE_BYTES = 528

#: Elements of the arrays in PX4's `sensor_combined`.
_GYRO = tuple(f"gyro_rad[{i}]" for i in range(3))
_ACCEL = tuple(f"accelerometer_m_s2[{i}]" for i in range(3))
_OF_BOARD = tuple(f"{sensor}{axis}" for sensor in ("Gyr", "Acc") for axis in "XYZ")
PX4 = {
    **dict.fromkeys(("sensor_combined", "vehicle_imu"), _GYRO + _ACCEL),
    **dict.fromkeys(("sensor_gyro", "sensor_accel", "sensor_gyro_fifo", "sensor_accel_fifo"), tuple(AXES)),
}
_BOARD = {"IMU": _OF_BOARD, "GYR": _OF_BOARD[:3], "ACC": _OF_BOARD[3:]}
#: Best first; names ending in MS are in ms, others in µs.
_STAMPS = ("timestamp_sample", "timestamp", "SampleUS", "TimeUS", "TimeMS")
_TEMPERATURES = ("temperature", "T")


class FlightLog(NamedTuple):
    """IMU messages by name and instance, dropouts in ms, and whether the log is damaged or cut off."""

    messages: dict[tuple[str, int], Fields]
    damaged: bool
    dropouts: list[int]
    truncated: bool = False


def ulog_content(path: Path) -> FlightLog:
    """Return the IMU messages of a ULog."""
    from pyulog import ULog

    walked = walk(path.read_bytes())
    with BytesIO(walked.sound()) if walked.resumed else path.open("rb") as file:
        log = ULog(file, message_name_filter_list=list(PX4))
    known = [e for e in log.data_list if e.name in PX4 and np.size(e.data.get("timestamp", ()))]
    # Copy: pyulog's fields are views of the whole messages.
    found = {
        (entry.name, int(entry.multi_id)): {k: np.ascontiguousarray(v) for k, v in entry.data.items()}
        for entry in known
    }
    dropouts = [int(dropout.duration) for dropout in log.dropouts]
    damaged = walked.damaged or bool(log.file_corruption)
    return flight_log(found, PX4, damaged=damaged, dropouts=dropouts)._replace(truncated=walked.truncated)


def flight_log(
    found: Mapping[tuple[str, int], Fields],
    kinds: Mapping[str, Sequence[str]],
    *,
    damaged: bool,
    dropouts: Sequence[int] = (),
) -> FlightLog:
    """Return the columns of messages; a log is damaged if one lacks a field."""
    messages: dict[tuple[str, int], Fields] = {}
    for key, fields in found.items():
        try:
            messages[key] = columns_of(key[0], fields, kinds[key[0]])
        except (KeyError, StopIteration):
            damaged = True
    return FlightLog(messages, damaged, [*dropouts])


def columns_of(message: str, fields: Fields, names: Sequence[str]) -> Fields:
    """Return time in ns, samples and temperature without damaged stamps; raises KeyError or StopIteration."""
    there = [name for name in _STAMPS if name in fields]
    best = next((name for name in there if bool(np.all(fields[name]))), there[-1] if there else "")
    stamps = fields[best]
    good = stamps < _MAX_STAMP_US
    times = np.where(good, stamps, 0).astype(np.int64) * (1_000_000 if best.endswith("MS") else 1000)
    if message.endswith("_fifo"):
        return dict(_of_fifo(fields, times, good))
    samples = dict(_rates(fields)) if message == "vehicle_imu" else {name: fields[name] for name in names}
    samples |= {name: fields[name] for name in _TEMPERATURES if name in fields}
    return {"timestamp": times[good], **{name: values[good] for name, values in samples.items()}}


def _rates(fields: Fields) -> Iterator[tuple[str, NDArray[Any]]]:
    for step, names in (("delta_angle", _GYRO), ("delta_velocity", _ACCEL)):
        micros = fields[f"{step}_dt"]
        yield from ((name, quotient(fields[f"{step}[{i}]"], micros)) for i, name in enumerate(names))


def _of_fifo(fields: Fields, last: IntArray, good: NDArray[np.bool_]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield every sample of a buffer; the stamp belongs to the last sample."""
    count = np.asarray(fields["samples"], np.int64)
    index = np.arange(sum(1 for name in fields if name.startswith("x[")))
    step, scale = np.asarray(fields["dt"], np.float64) * 1e3, np.asarray(fields["scale"], np.float64)
    good &= np.isfinite(step) & (count > 0) & (count <= index.size)
    filled = (index < count[:, None]) & good[:, None]
    before = (count[:, None] - 1 - index) * np.where(good, step, 0.0)[:, None]
    yield "timestamp", (last[:, None] - np.round(before).astype(np.int64))[filled]
    for axis in AXES:
        rows = np.stack([np.asarray(fields[f"{axis}[{i}]"], np.float64) for i in index], axis=1)
        yield axis, (rows * scale[:, None])[filled]


def dataflash_content(path: Path) -> FlightLog:
    """Return the IMU messages of a ``.bin``; bytes outside records are damage."""
    from pymavlink.DFReader import DFReader_binary

    class Index(DFReader_binary):  # type: ignore[misc]
        def init_clock(self) -> None:
            """Skip a second pass: the time since 1970 is not needed."""

    log = Index(str(path))
    found: dict[tuple[str, int], Fields] = {}
    spans: list[NDArray[np.int64]] = []
    for number, form in log.formats.items():
        starts = np.asarray(log.offsets[number], np.int64)
        starts = starts[starts + form.len <= log.data_len]
        spans.append(np.stack([starts, starts + form.len]))
        # Old logs have a message per IMU: IMU2, IMU3.
        name, last = form.name.rstrip("123"), form.name[-1:]
        if name in _BOARD and starts.size:
            data = _records(log.data_map, starts, form)
            instances = data.get("I", np.full(starts.size, int(last) - 1 if last.isdigit() else 0))
            for multi in np.unique(instances).tolist():
                found[name, multi] = {key: values[instances == multi] for key, values in data.items()}
    begun, ended = np.sort(np.concatenate(spans, axis=1), axis=1)
    whole = begun.size and not (begun[1:] - ended[:-1]).any() and log.data_len - ended[-1] <= _MAX_PAGE_BYTES
    return flight_log(found, _BOARD, damaged=not whole)


def _records(buffer: bytes, starts: IntArray, form: Any) -> Fields:  # noqa: ANN401 - of the package
    codes = re.findall(r"\d*[a-zA-Z]", form.msg_struct)
    types = [f"S{code[:-1]}" if code.endswith("s") else f"<{code}" for code in codes]
    row = np.dtype({"names": form.columns, "formats": types, "itemsize": form.len - 3})
    records = gather(buffer, starts + 3, row.itemsize).view(row)
    kinds = zip(form.columns, types, form.msg_mults, strict=True)
    return {name: records[name] * (scale or 1) for name, kind, scale in kinds if not kind.startswith("S")}


def open_log(path: Path, _: ReadOptions) -> ColumnLog:
    """Open a flight controller's log, with a table for each instance of an IMU message.

    Raises ReadError if it can't be read, if a package is missing, or if it has no IMU messages.
    """
    if first_bytes(path, len(ULOG)).startswith(ULOG[:4]):
        form, maker, kind, content = "ulog", "PX4", "ULog", ulog_content
    else:
        require(path, "pymavlink", "a log of ArduPilot", extra="ardupilot")
        form, maker, kind, content = "dataflash", "ArduPilot", "ArduPilot", dataflash_content
    found = isolated(path, content, kind)(path.absolute())
    dialect = Dialect(name=maker, headers=(), gyro_unit="rad/s", accel_unit="m/s^2")
    names = [name for name, _ in found.messages]
    labels = {(name, n): f"{name}:{n}" if names.count(name) > 1 else name for name, n in found.messages}
    tables = [_table(labels[key], key, fields, dialect) for key, fields in found.messages.items()]
    fastest = max((table.measured_hz or 0.0 for table in tables), default=0.0)
    log = ColumnLog(path, {labels[key]: [*fields.values()] for key, fields in found.messages.items()})
    log.form = form
    log.compression = "none"
    log.size_bytes = path.stat().st_size
    log.findings = [*log_findings(found)]
    log.advice = (
        f"no IMU messages; expected one of {', '.join(PX4)}; of ArduPilot {', '.join(_BOARD)}; log them with "
        "the sensor profile of the logger"
    )
    log.tables = [
        replace(table, weak=(table.measured_hz or 0.0) < _MIN_RATE_SHARE * fastest) for table in tables
    ]
    return log


def _table(name: str, key: tuple[str, int], fields: Fields, dialect: Dialect) -> Table:
    message, instance = key
    stamps = fields["timestamp"]
    types = {field: "time" if field == "timestamp" else v.dtype.name for field, v in fields.items()}
    return Table(
        name=name,
        alias=f"{message}:{instance}",
        kind=message,
        place=f"topic {name}",
        columns=tuple(
            Column(name=field, type=kind, unit=STAMPS if kind == "time" else None)
            for field, kind in types.items()
        ),
        head=lambda: [values[:HEAD_ROWS] for values in fields.values()],
        is_topic=True,
        count=stamps.size,
        first_ns=int(stamps[0]) if stamps.size else None,
        last_ns=int(stamps[-1]) if stamps.size else None,
        dialect=dialect,
        sparse=message == "vehicle_imu",
        fields=tuple(f"{field} {kind}" for field, kind in types.items()),
    )


def log_findings(log: FlightLog) -> Iterator[Finding]:
    """Yield findings about damage and dropouts."""
    if log.damaged:
        text = "Parts of the log are damaged; the readable parts were read."
        yield Finding("warning", "damaged", text)
    if log.truncated:
        text = "The log ends within a message: it is cut off, so its end is missing."
        yield Finding("warning", "truncated", text, "Copy it again, unless the power was cut.")
    if log.dropouts:
        count = "a dropout" if len(log.dropouts) == 1 else f"{len(log.dropouts)} dropouts"
        lost = sum(log.dropouts) / 1000
        text = f"The logger reports {count} of {lost:.3g} s in all: its card was too slow."
        yield Finding("info", "dropouts", text, "Use a faster card or log fewer topics.")

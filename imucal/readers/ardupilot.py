"""ArduPilot's logs, by pymavlink: ``.bin`` from the board's memory, ``.tlog`` of what it sent to the ground.

The package finds the records of a ``.bin`` and says what each kind holds; they are taken out in one go.
Messages: ``IMU``, or ``GYR`` and ``ACC`` of a batch log, in SI; of a ``.tlog`` ``HIGHRES_IMU`` in SI,
``SCALED_IMU`` in mg and mrad/s, and ``RAW_IMU``, which ArduPilot sends in these units and others in counts.
Source: ArduPilot, `AP_InertialSensor/LogStructure.h` and `GCS_Common.cpp` (`send_raw_imu`); MAVLink,
`common.xml`.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.readers.containers.container import gather
from imucal.readers.flight_messages import FlightLog, Message, flight_log
from imucal.recording import AXES, Sensor

#: The first bytes of each record of a dataflash log.
DATAFLASH = b"\xa3\x95"
#: A log ends with up to so many bytes of an unfinished page.
_PAGE = 528

_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
_OF_BOARD = {_GYRO: tuple(f"Gyr{axis}" for axis in "XYZ"), _ACCEL: tuple(f"Acc{axis}" for axis in "XYZ")}
_STAMPS = ("SampleUS", "TimeUS", "TimeMS")
_BOARD = {
    "IMU": Message(fields=_OF_BOARD, times=_STAMPS),
    "GYR": Message(fields={_GYRO: _OF_BOARD[_GYRO]}, times=_STAMPS),
    "ACC": Message(fields={_ACCEL: _OF_BOARD[_ACCEL]}, times=_STAMPS),
}
_SENT = Message(
    fields={_GYRO: tuple(f"{axis}gyro" for axis in AXES), _ACCEL: tuple(f"{axis}acc" for axis in AXES)},
    times=("time_usec", "time_boot_ms"),
)
_MILLI = replace(_SENT, units={_GYRO: "mrad/s", _ACCEL: "mg"})
_TELEMETRY = {
    "HIGHRES_IMU": _SENT,
    "SCALED_IMU": _MILLI,
    "SCALED_IMU2": _MILLI,
    "SCALED_IMU3": _MILLI,
    "RAW_IMU": _MILLI,
}
#: MAV_AUTOPILOT_ARDUPILOTMEGA: only this autopilot's RAW_IMU has units.
_ARDUPILOT = 3


def dataflash_content(path: Path) -> FlightLog:
    """Return the IMU messages of a ``.bin``; a part that is none of its records is damage."""
    from pymavlink.DFReader import DFReader_binary

    class Index(DFReader_binary):  # type: ignore[misc]
        def init_clock(self) -> None:
            """Pass over the records once, not twice: the time since 1970 is not needed."""

    log = Index(str(path))
    found: dict[tuple[str, int], dict[str, NDArray[Any]]] = {}
    spans: list[NDArray[np.int64]] = []
    for number, form in log.formats.items():
        starts = np.asarray(log.offsets[number], dtype=np.int64)
        starts = starts[starts + form.len <= log.data_len]
        spans.append(np.stack([starts, starts + form.len]))
        # Old logs have a message for each IMU: IMU2, IMU3.
        name, last = form.name.rstrip("123"), form.name[-1:]
        if name in _BOARD and starts.size:
            data = _columns(log.data_map, starts, form)
            instances = data.get("I", np.full(starts.size, int(last) - 1 if last.isdigit() else 0))
            for multi in np.unique(instances).tolist():
                own = {key: values[instances == multi] for key, values in data.items()}
                found[name, multi] = own | ({"temperature": own["T"]} if "T" in own else {})
    begun, ended = np.sort(np.concatenate(spans, axis=1), axis=1)
    whole = begun.size and not (begun[1:] - ended[:-1]).any() and log.data_len - ended[-1] <= _PAGE
    return flight_log("dataflash", found, _BOARD, damaged=not whole)


def _columns(buffer: bytes, starts: IntArray, form: Any) -> dict[str, NDArray[Any]]:  # noqa: ANN401 - of the package
    """Return the numbers of all records of one kind by their names, shape (n,) each."""
    codes = re.findall(r"\d*[a-zA-Z]", form.msg_struct)
    types = [f"S{code[:-1]}" if code.endswith("s") else f"<{code}" for code in codes]
    row = np.dtype({"names": form.columns, "formats": types, "itemsize": form.len - 3})
    records = gather(buffer, starts + 3, row.itemsize).view(row)
    kinds = zip(form.columns, types, form.msg_mults, strict=True)
    return {name: records[name] * (scale or 1) for name, kind, scale in kinds if not kind.startswith("S")}


def telemetry_content(path: Path) -> FlightLog:
    """Return the IMU messages of a ``.tlog``; those of several vehicles are instances."""
    from pymavlink.mavutil import mavlogfile

    log = mavlogfile(str(path))
    rows: dict[tuple[str, int], list[Any]] = defaultdict(list)
    makers: dict[int, int] = {}
    while (message := log.recv_msg()) is not None:
        name = message.get_type()
        if name == "HEARTBEAT":
            makers.setdefault(message.get_srcSystem(), message.autopilot)
        elif name in _TELEMETRY:
            rows[name, message.get_srcSystem()].append(message)
    kinds = dict(_TELEMETRY)
    if _ARDUPILOT not in makers.values():
        kinds["RAW_IMU"] = replace(_SENT, units=dict.fromkeys(Sensor))
    found = {key: _fields(messages, kinds[key[0]]) for key, messages in rows.items()}
    return flight_log("tlog", found, kinds, damaged=bool(log.mav.total_receive_errors))


def _fields(messages: Sequence[Any], kind: Message) -> dict[str, NDArray[Any]]:
    names = [name for fields in kind.fields.values() for name in fields]
    names += [name for name in kind.times if hasattr(messages[0], name)]
    return {name: np.array([getattr(message, name) for message in messages]) for name in names}

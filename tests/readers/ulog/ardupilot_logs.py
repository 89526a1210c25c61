"""Simulated ArduPilot logs: ``.bin`` built byte by byte, and telemetry written by pymavlink."""

import io
import struct
from pathlib import Path

import numpy as np

from imucal.units import G0

__all__ = ["N", "truth", "write_dataflash", "write_telemetry"]

#: Number of samples, at 100 Hz.
N = 300

_IMU = ("IMU", "QBfffffffB", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T,Health")
_SIZES = {"Q": 8, "B": 1, "f": 4, "n": 4, "N": 16, "Z": 64, "I": 4, "h": 2}


def truth() -> tuple[np.ndarray, np.ndarray]:
    """Return rates in rad/s and forces in m/s², shape (N, 3), rounded to 32 bits."""
    rng = np.random.default_rng(12)
    gyro = rng.normal(scale=2e-3, size=(N, 3)) + np.array([0.01, -0.02, 0.005])
    accel = rng.normal(scale=2e-2, size=(N, 3)) + np.array([0.1, -0.2, G0])
    return gyro.astype(np.float32).astype(np.float64), accel.astype(np.float32).astype(np.float64)


def _format(number: int, name: str, form: str, columns: str) -> bytes:
    size = 3 + sum(_SIZES[letter] for letter in form)
    body = struct.pack("<BB4s16s64s", number, size, name.encode(), form.encode(), columns.encode())
    return b"\xa3\x95\x80" + body


def write_dataflash(path: Path, *, instances: int = 1, batch: bool = False) -> Path:
    """Write a log of IMU messages, or a batch log of GYR and, at half the rate, ACC."""
    gyro, accel = truth()
    data = _format(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    data += _format(0x81, *_IMU)
    data += _format(0x82, "GYR", "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ")
    data += _format(0x83, "ACC", "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ")
    data += _format(0x84, "MSG", "QZ", "TimeUS,Message")
    data += b"\xa3\x95\x84" + struct.pack("<Q64s", 5, b"ArduCopter V4.5.7")
    for k in range(N):
        now = 1_000_000 + 10_000 * k
        for i in range(instances):
            if not batch:
                values = (*gyro[k] + i, *accel[k], 31.5, 1)
                data += b"\xa3\x95\x81" + struct.pack("<QBfffffffB", now, i, *values)
            else:
                data += b"\xa3\x95\x82" + struct.pack("<QBQfff", now + 77, i, now, *gyro[k])
                if k % 2 == 0:
                    data += b"\xa3\x95\x83" + struct.pack("<QBQfff", now + 99, i, now, *accel[k])
    # The rest of the last page.
    path.write_bytes(data + b"\xff" * 100)
    return path


def write_telemetry(path: Path) -> Path:
    """Write the telemetry of a vehicle: a heartbeat every second, and RAW_IMU in mg and mrad/s at 100 Hz."""
    from pymavlink.dialects.v20 import ardupilotmega

    gyro, accel = truth()
    link = ardupilotmega.MAVLink(io.BytesIO(), srcSystem=1, srcComponent=1)
    pieces = []

    def put(message: ardupilotmega.MAVLink_message, now: int) -> None:
        pieces.append(struct.pack(">Q", 1_760_000_000_000_000 + now) + message.pack(link))
        link.seq = (link.seq + 1) % 256

    for k in range(N):
        now = 1_000_000 + 10_000 * k
        if k % 100 == 0:
            put(link.heartbeat_encode(2, 3, 0, 0, 4), now)
        counts = [round(value) for value in (*accel[k] / G0 * 1e3, *gyro[k] * 1e3)]
        put(link.raw_imu_encode(now, *counts, 0, 0, 0), now)
    path.write_bytes(b"".join(pieces))
    return path

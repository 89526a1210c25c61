"""Messages of imucal about common mistakes of new users: each command is run and its output printed.

    python tests/benchmarks/first_slips.py
    python tests/benchmarks/first_slips.py --python OTHER/bin/python --path OTHER

The second form uses another version of the package. `--short` only prints exit codes and first lines.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tests.readers.logs import Message, header, samples, store, write_mcap
from tests.readers.messages.test_definition_files import log as write_undefined
from tests.readers.messages.test_definition_files import package
from tests.readers.messages.test_named_columns import counts, protobuf_log, single
from tests.readers.ulog.test_ulog import two_sensors

N = 600
UNITS = "gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"
RNG = np.random.default_rng(11)
GYRO = RNG.normal(0, 2e-3, (N, 3)) + np.array([0.01, -0.02, 0.005])
ACCEL = RNG.normal(0, 0.02, (N, 3)) + np.array([0.1, -0.2, 9.81])
VALUES = [[f"{value:.6f}" for value in column] for column in np.hstack([GYRO, ACCEL]).T]
SECONDS = [f"{0.01 * i:.2f}" for i in range(N)]
MOMENTS = [datetime(2026, 11, 22, 11, 59, 58, tzinfo=UTC) + timedelta(milliseconds=10 * i) for i in range(N)]


def rows(head: str, *columns: Sequence[object], mark: str = ",", end: str = "") -> str:
    body = [mark.join(str(column[i]) for column in columns) + end for i in range(N)]
    return "\n".join([*([head] if head else []), *body]) + "\n"


def text(content: str, encoding: str = "utf-8") -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content.encode(encoding))


def quoted() -> str:
    columns = [['"' + cell.replace(".", ",") + '"' for cell in column] for column in (SECONDS, *VALUES)]
    return rows(f"time (s),{UNITS}", *columns)


def repo_imu() -> str:
    ones = [["0.5"] * N] * 4
    groups = "Time;Vicon quat;;;;IMU acc;;;IMU gyr;;;IMU mag;;;\n"
    axes = "[s];W;X;Y;Z;X [m/s^2];Y [m/s^2];Z [m/s^2];X [rad/s];Y [rad/s];Z [rad/s];X;Y;Z;"
    return rows(groups + axes, SECONDS, *ones, *VALUES[3:], *VALUES[:3], *ones[:3], mark=";", end=";")


def moving() -> str:
    swing = [[f"{2 * np.sin(0.02 * i + phase):.6f}" for i in range(N)] for phase in range(3)]
    return rows("time (s),gx,gy,gz,ax,ay,az", SECONDS, *swing, *VALUES[3:])


def json_messages(path: Path) -> None:
    kind, truth = "any", samples(120)
    messages = [
        Message(
            topic="/imu",
            type=kind,
            log=log,
            data=json.dumps({"w": truth.gyro[i].tolist(), "f": truth.accel[i].tolist()}).encode(),
            encoding="json",
        )
        for i, log in enumerate(truth.log.tolist())
    ]
    write_mcap(path, messages, definitions={kind: ("jsonschema", "{}")})


def other_encoding(path: Path) -> None:
    messages = [
        Message(topic="/imu", type="acme.Imu", log=i, data=b"\x00", encoding="flatbuffer") for i in range(9)
    ]
    write_mcap(path, messages, definitions={"acme.Imu": ("flatbuffer", "")})


def list_of_imus(path: Path) -> None:
    """Write messages of two IMUs each."""
    truth = samples(120)
    types = store(
        acme__msg__One="std_msgs/Header header\nfloat64[3] rate\nfloat64[3] force",
        acme__msg__Board="std_msgs/Header header\nOne[] imus",
    )
    known: Any = types.types
    messages = []
    for i, log in enumerate(truth.log.tolist()):
        stamp = header(types, int(truth.stamps[i]))
        one = known["acme/msg/One"](stamp, truth.gyro[i], truth.accel[i])
        message = known["acme/msg/Board"](stamp, [one, one])
        data = bytes(types.serialize_cdr(message, "acme/msg/Board"))
        messages.append(Message(topic="/board", type="acme/msg/Board", log=log, data=data))
    write_mcap(path, messages, types=types)


def zeroed_definitions(path: Path) -> None:
    """Write a ULog that makes its package seek back endlessly."""
    data = bytearray(two_sensors(path).read_bytes())
    data[296:596] = bytes(300)
    path.write_bytes(data)


def damaged_parquet(path: Path) -> None:
    """Write a table whose page headers are wrong."""
    columns = {f"gyro_{axis}_rads": GYRO[:, i] for i, axis in enumerate("xyz")}
    pl.DataFrame({"time_s": 0.01 * np.arange(N), **columns}).write_parquet(path)
    data = bytearray(path.read_bytes())
    data[4:200] = bytes(range(196))
    path.write_bytes(data)


def in_folder(writer: Callable[[Path], Path]) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        with tempfile.TemporaryDirectory() as folder:
            writer(Path(folder)).replace(path)

    return write


#: File -> function that writes it.
FILES: dict[str, Callable[[Path], object]] = {
    "t100.csv": text(rows(f"time,{UNITS}", [100 * i for i in range(N)], *VALUES)),
    "bench.csv": text(rows(f"t,{UNITS}", [f"{2e-5 * i:.6f}" for i in range(N)], *VALUES)),
    "us.csv": text(rows(f"date,{UNITS}", [t.strftime("%m/%d/%Y %I:%M:%S.%f %p") for t in MOMENTS], *VALUES)),
    "iso.csv": text(rows(f"date,{UNITS}", [t.isoformat() for t in MOMENTS], *VALUES)),
    "blanks.txt": text(
        rows(
            "time gx_rads gy_rads gz_rads ax_ms2 ay_ms2 az_ms2",
            [t.strftime("%Y-%m-%d %H:%M:%S.%f") for t in MOMENTS],
            *VALUES,
            mark=" ",
        )
    ),
    "excel.csv": text(quoted()),
    "windows.csv": text(rows(f"time (s),{UNITS}", SECONDS, *VALUES), "utf-16-le"),
    "repoimu.csv": text(repo_imu()),
    "matlab.txt": text(rows("", SECONDS, *VALUES, mark=" ", end=";")),
    "bare.csv": text(rows("", SECONDS, *VALUES[3:], *VALUES[:3])),
    "moving.csv": text(moving()),
    "cube.npy": lambda path: np.save(path, np.stack([GYRO, ACCEL], axis=1)),
    "wide.npy": lambda path: np.save(path, np.hstack([GYRO, ACCEL, np.zeros((N, 90))])),
    "raw.mcap": in_folder(single),
    "counts.mcap": in_folder(counts),
    "list.mcap": list_of_imus,
    "undefined.mcap": in_folder(write_undefined),
    "json.mcap": json_messages,
    "proto.mcap": in_folder(protobuf_log),
    "flat.mcap": other_encoding,
    "zeroed.ulg": zeroed_definitions,
    "damaged.parquet": damaged_parquet,
}

#: Topic, and command.
SLIPS = (
    ("time", "adev t100.csv"),
    ("time", "adev t100.csv --time-unit ms"),
    ("time", "adev t100.csv --rate 10"),
    ("time", "adev t100.csv --columns g=1:4,a=4:7 --rate 10"),
    ("time", "adev t100.csv --time-unit minutes"),
    ("time", "adev bench.csv"),
    ("time", "adev bench.csv --time-unit s"),
    ("time", "adev us.csv"),
    ("time", "adev iso.csv --time-unit s"),
    ("time", "adev blanks.txt"),
    ("time", "adev excel.csv"),
    ("time", "adev windows.csv"),
    ("messages", "adev raw.mcap"),
    ("messages", "adev raw.mcap --columns g=gx+gy+gz,a=ax+ay+az"),
    ("messages", "adev raw.mcap --columns g=wx+wy+wz"),
    ("messages", "adev raw.mcap --columns g=gx+gy"),
    ("messages", "adev raw.mcap --time-unit ms"),
    ("messages", "info -v raw.mcap"),
    ("messages", "adev counts.mcap --columns g=g,a=a"),
    ("messages", "adev list.mcap"),
    ("messages", "adev list.mcap --columns g=imus[0].rate,a=imus[0].force"),
    ("messages", "adev undefined.mcap --topic /board"),
    ("messages", "adev undefined.mcap --msg src/acme/msg/Board.msg"),
    ("messages", "adev undefined.mcap --msg src"),
    ("messages", "adev json.mcap"),
    ("messages", "adev proto.mcap --topic /imu/data"),
    ("messages", "adev proto.mcap --columns g=turning_dps,a=push_g --gyro-unit deg/s --accel-unit g"),
    ("messages", "adev flat.mcap"),
    ("tables", "adev repoimu.csv"),
    ("tables", "adev matlab.txt"),
    ("tables", "adev bare.csv"),
    ("tables", "adev bare.csv --columns g=1-3,a=4-6"),
    ("tables", "adev moving.csv"),
    ("tables", "adev cube.npy"),
    ("tables", "adev wide.npy"),
    ("damage", "adev zeroed.ulg"),
    ("damage", "adev damaged.parquet"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--path", default=None)
    parser.add_argument("--short", action="store_true")
    asked = parser.parse_args()
    environment = {**os.environ, **({"PYTHONPATH": asked.path} if asked.path else {})}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        package(folder)
        for file, write in FILES.items():
            write(folder / file)
        for number, (point, typed) in enumerate(SLIPS, 1):
            print(f"\n{number}. [{point}] imucal {typed}")
            try:
                done = subprocess.run(  # noqa: S603 - the package's own command
                    [asked.python, "-m", "imucal", *shlex.split(typed)],
                    cwd=folder,
                    env=environment,
                    capture_output=True,
                    text=True,
                    check=False,
                    timeout=60,
                )
            except subprocess.TimeoutExpired:
                print("   no answer after 60 s")
                continue
            output = (done.stdout if typed.startswith("info") else done.stderr).strip()
            lines = output.splitlines()
            for line in lines[:1] if asked.short else lines[:14]:
                print(f"   {line}")
            print(f"   exit code {done.returncode}")


if __name__ == "__main__":
    main()

"""Compare the recordings that two versions read from the same files.

    python tests/benchmarks/same_recordings.py write FOLDER recordings.json
    python tests/benchmarks/same_recordings.py compare before.json after.json

The files are the sample logs, real recordings (in the folder IMUCAL_REAL_DATA), every format that the tests
write, and damaged copies of these; FOLDER keeps the written ones, so that both versions read the same bytes.
Samples, clocks, units, temperature, findings and the texts of refusals are compared. The exit code is 1 if a
recording differs, not if only texts do.
"""

import hashlib
import json
import os
import sys
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from imucal.errors import ChoiceError, ImucalError
from imucal.readers import describe, read
from imucal.recording import Recording
from tests.readers.logs import CONTAINERS, samples
from tests.readers.tables.texts import STYLES, write

SAMPLE_LOGS = Path(__file__).parents[2] / "sample_logs"
DATA = Path(os.environ.get("IMUCAL_REAL_DATA", Path(__file__).parents[2] / "shared" / "data"))
#: Names of files that are no logs.
NO_LOGS = ("LICENSE", "README", "manifest", "published", "SHA256")
NO_LOG_ENDINGS = {".md", ".yaml", ".yml", ".json", ".py", ".png"}
#: Larger real files, in bytes, are read only once, without a damaged copy.
LARGE = 30_000_000
#: Raw counts of real logs -> SI.
MPU6050 = {"gyro_scale": float(np.pi / 180 / 131), "accel_scale": 9.80665 / 16384}
ADIS = {"rate_hz": 819.2, "gyro_scale": float(0.05 * np.pi / 180), "accel_scale": 0.00333 * 9.80665}

#: Names of real files, and the options with which they are read again.
WITH_OPTIONS: list[tuple[tuple[str, ...], dict[str, Any]]] = [
    (("real/adis16405/adis16405_run1.npz",), ADIS),
    (("real/adis16405/adis16405_run2.npz",), ADIS),
    (("real/mpu6050/example_data_calibration.csv",), MPU6050),
    (("real/mpu6050/imu_static_test.csv",), MPU6050),
    (("formats/xio_fusion_sensor_data.csv",), {"topic": "/imu"}),
    (("formats/robot_localization_test1_husky.bag",), {"time": "log"}),
    (("formats/robot_localization_test1_husky.bag",), {"topic": "/no_such"}),
    (("formats/novatel_ins1.bag",), {"topic": "/novatel/oem7/corrimu"}),
    (("formats/novatel_ins1.bag",), {"topic": "/gps/imu"}),
    (("formats/madlab_imucal_ferraris_session.csv",), {"rate_hz": 204.8, "gyro_unit": "deg/s"}),
    (("formats/gnss_ins_sim_gyro_deg.csv", "formats/gnss_ins_sim_accel.csv"), {"rate_hz": 100.0}),
    (
        ("formats/px4_ecl_replay_iris_gps.csv",),
        {"columns": "t=0,g=5:8@imu,a=2:5@imu", "gyro_unit": "rad/s"},
    ),
    (
        ("formats/invariant_ekf_tagged.txt",),
        {"columns": "t=1,g=2:5@IMU,a=5:8@IMU", "gyro_unit": "rad/s", "accel_unit": "m/s^2"},
    ),
    (("formats/scikit_kinematics_xsens.txt",), {"rate_hz": 100.0}),
    (("formats/scikit_kinematics_xio_33.csv",), {"rate_hz": 256.0}),
    (("formats/st_unico_datalog.txt",), {"rate_hz": 26667.0 / 16}),
    (("formats/rosbag2_cdr_test_0.db3",), {"columns": "g=0:3"}),
    (("real/mpu6050/same_samples_every_format/ros2_mcap",), {}),
    (("real/mpu6050/same_samples_every_format/ros2_sqlite3",), {}),
]


@dataclass(frozen=True)
class Case:
    """Files to read as one recording."""

    name: str
    paths: tuple[Path, ...]
    options: dict[str, Any] = field(default_factory=dict)


def cases(folder: Path) -> Iterator[Case]:
    """Yield all cases; `folder` contains written files, or receives them."""
    real = [path for path in sorted(DATA.rglob("*")) if is_log(path)]
    logs = [path for path in sorted(SAMPLE_LOGS.glob("*")) if is_log(path)]
    for path in logs + real:
        yield Case(f"{path.parent.name}/{path.name}", (path,))
    for names, options in WITH_OPTIONS:
        paths = tuple(DATA / name for name in names)
        if all(path.exists() for path in paths):
            yield Case(f"{' '.join(names)} {sorted(options)}", paths, options)
    yield from made_cases(folder)


def made_cases(folder: Path) -> Iterator[Case]:
    """Yield the files that the tests write, and damaged copies of all files."""
    logs = [path for root in (SAMPLE_LOGS, DATA) for path in sorted(root.rglob("*")) if is_log(path)]
    written = folder / "written"
    if not written.exists():
        write_all(written)
    for path in files_in(written):
        yield Case(str(path.relative_to(written)), (path,))
    for style in STYLES:
        place = written / "styles" / style.name.replace(" ", "_").replace("/", "_")
        yield Case(f"style {style.name} with options", (place / style.file,), dict(style.options))
    damaged = folder / "damaged"
    if not damaged.exists():
        sources = [path for path in files_in(written) if "styles" not in path.parts]
        damage_all([*sources, *(path for path in logs if path.stat().st_size < LARGE)], damaged)
    for path in files_in(damaged):
        yield Case(f"damaged {path.relative_to(damaged)}", (path,))


def files_in(folder: Path) -> list[Path]:
    """Return all files below a folder."""
    return [path for path in sorted(folder.rglob("*")) if path.is_file()]


def is_log(path: Path) -> bool:
    """Return whether a path is a file with samples."""
    return path.is_file() and not path.name.startswith(NO_LOGS) and path.suffix not in NO_LOG_ENDINGS


def write_all(folder: Path) -> None:
    """Write a log in each container, text layout and typed format."""
    truth = samples(2000)
    for name, writer in CONTAINERS.items():
        place = folder / name
        place.mkdir(parents=True)
        writer(place, truth)
    for style in STYLES:
        place = folder / "styles" / style.name.replace(" ", "_").replace("/", "_")
        place.mkdir(parents=True)
        write(style, place)
    write_typed(folder / "typed")


def write_typed(folder: Path) -> None:
    """Write Parquet, HDF5, NPZ, NPY and MAT files."""
    import polars as pl
    import scipy.io

    folder.mkdir(parents=True)
    truth = samples(2000)
    stamps, gyro, accel = truth.stamps, truth.gyro, truth.accel
    names = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
    columns = dict(zip(names, truth.all.T, strict=True))
    pl.DataFrame({"timestamp_ns": stamps, **columns}).write_parquet(folder / "log.parquet")
    np.savez(folder / "log.npz", timestamp_ns=stamps, gyro_rad_s=gyro, accel_m_s2=accel)
    np.savez(folder / "two_lengths.npz", timestamp_ns=stamps, gyro=gyro, accel=accel, magnet=gyro[:100])
    np.savez(folder / "scaled.npz", fs=200.0, gyro=gyro, accel=accel)
    np.save(folder / "log.npy", np.column_stack([stamps * 1e-9, truth.all]))
    scipy.io.savemat(
        folder / "log.mat", {"imu": {"t": (stamps - stamps[0]) * 1e-9, "gyro": gyro, "acc": accel}}
    )
    try:
        import h5py
    except ImportError:
        return
    with h5py.File(folder / "log.h5", "w") as file:
        file["imu/time_ns"] = stamps
        file["imu/gyro"] = gyro
        file["imu/accel"] = accel


def damage_all(paths: list[Path], folder: Path) -> None:
    """Write copies of files that are cut off, or have 40 damaged bytes in the middle."""
    folder.mkdir(parents=True)
    for number, path in enumerate(paths):
        data = path.read_bytes()
        cut = folder / f"{number}_cut_{path.name}"
        cut.write_bytes(data[: len(data) * 3 // 5])
        middle = len(data) // 2
        noise = np.random.default_rng(number).bytes(40)
        changed = folder / f"{number}_changed_{path.name}"
        changed.write_bytes(data[:middle] + noise + data[middle + 40 :])


def digest(array: Any) -> str:  # noqa: ANN401 - of any type
    """Return a hash of an array's bytes."""
    return hashlib.md5(np.ascontiguousarray(array).tobytes(), usedforsecurity=False).hexdigest()


def summary(recording: Recording) -> dict[str, Any]:
    """Return everything that a user or the analysis sees of a recording."""
    axes = {}
    for series in recording.series:
        clock = series.clock
        axes[series.name] = {
            "n": series.n,
            "samples": digest(series.samples),
            "rate_hz": clock.rate_hz,
            "start_ns": clock.start_ns,
            "source": clock.source,
            "jitter_s": clock.jitter_s,
            "segments": hashlib.md5(repr(clock.segments).encode(), usedforsecurity=False).hexdigest(),
        }
    heat = recording.temperature
    findings = [(one.level, one.code, one.axis or "", one.text, one.advice) for one in recording.findings]
    return {
        "axes": axes,
        "temperature": None if heat is None else [heat.samples.size, digest(heat.samples)],
        "format": recording.source.format,
        "topics": list(recording.source.topics),
        "types": list(recording.source.message_types),
        "values": dict(recording.source.values),
        "decisions": sorted(map(list, recording.source.decisions)),
        "findings": sorted(map(list, findings)),
    }


def outcome(case: Case) -> dict[str, Any]:
    """Return the summary of a recording, or the error."""
    try:
        return summary(read(*case.paths, **case.options))
    except ImucalError as error:
        arguments = [fix.argument for part in error.parts() for fix in part.fixes]
        kind = "ChoiceError" if isinstance(error, ChoiceError) else type(error).__name__
        return {"error": kind, "text": str(error), "arguments": arguments}
    except Exception:  # noqa: BLE001 - every other error is a fault that the comparison shows
        return {"error": "fault", "text": traceback.format_exc()[-600:], "arguments": []}


def described(case: Case) -> Any:  # noqa: ANN401 - JSON
    """Return what ``imucal info`` prints of a file."""
    if len(case.paths) > 1 or case.options:
        return None
    try:
        contents = describe(case.paths[0])
    except ImucalError as error:
        return str(error)
    except Exception:  # noqa: BLE001
        return f"fault {traceback.format_exc()[-600:]}"
    topics = [
        [one.name, one.type, one.count, one.rate_hz, one.duration_s, list(map(str, one.sensors)), one.note]
        for one in contents.topics
    ]
    return {
        "topics": topics,
        "format": contents.format,
        "size": contents.size_bytes,
        "compression": contents.compression,
        "start_ns": contents.start_ns,
        "duration_s": contents.duration_s,
    }


def write_outcomes(folder: Path, target: Path) -> None:
    """Read all files, and write what was found."""
    found = {}
    for case in cases(folder):
        start = time.process_time()
        result = outcome(case)
        seconds = time.process_time() - start
        found[case.name] = {"read": result, "described": described(case), "seconds": seconds}
    target.write_text(json.dumps(found, indent=1, default=str), encoding="utf-8")
    kinds = Counter(one["read"].get("error", "read") for one in found.values())
    print(f"{len(found)} cases: {dict(kinds)}; {sum(one['seconds'] for one in found.values()):.0f} s of CPU")


#: Keys whose values decide the result; the others are texts.
NUMBERS = ("axes", "temperature", "values")


def compare(before: Path, after: Path) -> int:
    """Print the differences; return the number of recordings that differ in more than texts."""
    old = json.loads(before.read_text(encoding="utf-8"))
    new = json.loads(after.read_text(encoding="utf-8"))
    counts: Counter[str] = Counter()
    for name in sorted(old.keys() | new.keys()):
        if name not in old or name not in new:
            print(f"ONLY IN ONE  {name}")
            counts["different"] += 1
            continue
        one, other = old[name]["read"], new[name]["read"]
        numbers = [key for key in NUMBERS if one.get(key) != other.get(key)]
        texts = [key for key in sorted(one.keys() | other.keys()) if one.get(key) != other.get(key)]
        codes = [{(row[0], row[1], row[2]) for row in part.get("findings", ())} for part in (one, other)]
        if ("error" in one) != ("error" in other) or numbers or codes[0] != codes[1]:
            counts["different"] += 1
            print(f"DIFFERENT    {name}: {numbers or 'error or findings'}")
            print_parts(one, other, texts)
        elif texts:
            counts["texts"] += 1
            print(f"texts        {name}")
            print_parts(one, other, texts)
        else:
            counts["same"] += 1
        if old[name]["described"] != new[name]["described"]:
            counts["described"] += 1
            print(f"described    {name}\n   - {old[name]['described']}\n   + {new[name]['described']}")
    print(dict(counts))
    return counts["different"]


def print_parts(one: dict[str, Any], other: dict[str, Any], keys: list[str]) -> None:
    """Print what differs in two outcomes."""
    for key in keys:
        before, after = one.get(key), other.get(key)
        if isinstance(before, list) and isinstance(after, list):
            before, after = (
                [row for row in before if row not in after],
                [row for row in after if row not in before],
            )
        print(f"   - {key} {str(before)[:500]}\n   + {key} {str(after)[:500]}")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["write", place, target]:
            write_outcomes(Path(place).absolute(), Path(target))
        case ["compare", first, second]:
            sys.exit(compare(Path(first), Path(second)) > 0)
        case _:
            sys.exit(__doc__)

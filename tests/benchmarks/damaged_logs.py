"""Damage small logs at random and read them: unexpected errors, and losses that nobody reports.

    python -m tests.benchmarks.damaged_logs --seed 20261128 --files 1500

Every container gets the same number of damaged files. A damage flips, inserts, deletes, zeroes or swaps bytes
or sectors, or cuts the file. Each file is read once, and falls into one of these columns:

- refused: an error of imucal, as for a damaged file;
- reported: read, with a finding about damage;
- equal: read without a finding, and all samples equal those of the sound log;
- changed: read without a finding; samples differ, but no checksum in the file covers them;
- silent: read without a finding, although samples are missing, or differ in spite of a checksum;
- crashed: an exception that is not an error of imucal, which the command line reports with exit code 70.
"""

import argparse
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import scipy.io

from imucal.errors import ImucalError
from imucal.readers import isolation, read
from imucal.readers.assemble import DAMAGE
from imucal.recording import Recording
from tests.readers.logs import Samples, imu_messages, samples, write_bag, write_db3, write_mcap
from tests.readers.tables.hdf5_logs import write_hdf5
from tests.readers.ulog.test_ulog import two_sensors

#: Samples of each log: a damage hits samples rather than the index.
N = 400
#: Bytes of a sector of a disk.
SECTOR = 512
#: Codes of findings that report a damage or a loss.
REPORTED = DAMAGE | {"file-missing", "bad-rows", "duplicate-stamps", "stamps-out-of-order"}
#: Timeout of a parser in s; small logs take 0.1 s.
PATIENCE_S = 5.0
OPTIONS: dict[str, Any] = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}


def bytes_of_bag(folder: Path) -> Path:
    """Return the only file of a bag's folder that contains messages."""
    return next(path for path in folder.iterdir() if path.name != "metadata.yaml")


def write_table(path: Path, truth: Samples) -> Path:
    """Write the samples as a table; the extension of `path` is its format."""
    columns: dict[str, Any] = {"time_ns": truth.stamps, "gyro": truth.gyro, "accel": truth.accel}
    if path.suffix == ".npz":
        np.savez_compressed(path, **columns)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, columns, do_compression=True)
    elif path.suffix == ".h5":
        write_hdf5(path, columns)
    elif path.suffix == ".npy":
        kinds = [("time_ns", "<i8"), ("gyro", "<f8", 3), ("accel", "<f8", 3)]
        table = np.zeros(truth.stamps.size, dtype=kinds)
        for name, values in columns.items():
            table[name] = values
        np.save(path, table)
    else:
        named: dict[str, Any] = {"time_ns": truth.stamps}
        for sensor, values in (("gyro", truth.gyro), ("accel", truth.accel)):
            named |= {f"{sensor}_{axis}": values[:, i] for i, axis in enumerate("xyz")}
        pl.DataFrame(named).write_parquet(path)
    return path


#: Container -> function that writes a log into a folder and returns the file to damage.
WRITERS: dict[str, Callable[[Path, Samples], Path]] = {
    "mcap, zstd": lambda folder, truth: write_mcap(folder / "log.mcap", imu_messages(truth)),
    "mcap, lz4": lambda folder, truth: write_mcap(
        folder / "log.mcap", imu_messages(truth), compression="lz4"
    ),
    "mcap, none": lambda folder, truth: write_mcap(
        folder / "log.mcap", imu_messages(truth), compression="none"
    ),
    "bag, none": lambda folder, truth: write_bag(folder / "log.bag", imu_messages(truth, ros1=True)),
    "bag, lz4": lambda folder, truth: write_bag(
        folder / "log.bag", imu_messages(truth, ros1=True), compression="lz4"
    ),
    "bag, bz2": lambda folder, truth: write_bag(
        folder / "log.bag", imu_messages(truth, ros1=True), compression="bz2"
    ),
    "db3": lambda folder, truth: bytes_of_bag(write_db3(folder / "bag", imu_messages(truth))),
    "db3, messages": lambda folder, truth: bytes_of_bag(
        write_db3(folder / "bag", imu_messages(truth), compression="message")
    ),
    "db3.zstd": lambda folder, truth: bytes_of_bag(
        write_db3(folder / "bag", imu_messages(truth), compression="file")
    ),
    "ulg": lambda folder, _: two_sensors(folder / "log.ulg"),
    "parquet": lambda folder, truth: write_table(folder / "log.parquet", truth),
    "h5": lambda folder, truth: write_table(folder / "log.h5", truth),
    "npz": lambda folder, truth: write_table(folder / "log.npz", truth),
    "npy": lambda folder, truth: write_table(folder / "log.npy", truth),
    "mat": lambda folder, truth: write_table(folder / "log.mat", truth),
}
#: Containers with a checksum of all samples.
CHECKED = frozenset({"mcap, zstd", "mcap, lz4", "mcap, none", "npz", "bag, bz2", "mat"})
#: Containers without a number of samples: a log cut between two messages looks complete.
UNCOUNTED = frozenset({"ulg"})
KINDS = ("flip", "cut", "insert", "delete", "zero", "swap")


def damaged(data: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """Return damaged bytes of a file."""
    at, size = int(rng.integers(0, len(data))), int(rng.integers(1, 200))
    sector = at // SECTOR * SECTOR
    changed = bytearray(data)
    if kind == "flip":
        changed[at] ^= 1 << int(rng.integers(0, 8))
    elif kind == "cut":
        del changed[at:]
    elif kind == "insert":
        changed[at:at] = rng.bytes(size)
    elif kind == "delete":
        del changed[at : at + size]
    elif kind == "zero":
        changed[sector : sector + SECTOR] = bytes(len(changed[sector : sector + SECTOR]))
    else:
        # The last sector may be incomplete.
        whole = max(len(data) // SECTOR - 1, 1)
        first, second = (int(number) * SECTOR for number in rng.integers(0, whole, 2))
        changed[first : first + SECTOR] = data[second : second + SECTOR]
        changed[second : second + SECTOR] = data[first : first + SECTOR]
    return bytes(changed)


def outcome_of(path: Path, sound: Recording, name: str) -> tuple[str, str]:
    """Return the column of a damaged file, and the text of an unexpected error or a loss."""
    try:
        found = read(path, **OPTIONS)
    except ImucalError:
        return "refused", ""
    except Exception:  # noqa: BLE001 - the errors that are counted
        return "crashed", traceback.format_exc()
    if {finding.code for finding in found.findings} & REPORTED:
        return "reported", ""
    loss = loss_of(found, sound, name)
    if loss:
        return "silent", f"{loss}; findings {[finding.code for finding in found.findings]}"
    pairs = zip(sound.series, found.series, strict=True)
    equal = all(np.array_equal(one.samples, other.samples) for one, other in pairs)
    return ("equal" if equal else "changed"), ""


def loss_of(found: Recording, sound: Recording, name: str) -> str:
    """Return what a recording lacks, or an empty text."""
    if len(found.series) < len(sound.series):
        return f"{len(found.series)} of {len(sound.series)} axes"
    for one, other in zip(sound.series, found.series, strict=False):
        if other.n < one.n and name not in UNCOUNTED:
            return f"{one.n - other.n} samples lost"
        if name in CHECKED and not np.array_equal(one.samples, other.samples):
            return "values differ"
    return ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=20261128)
    parser.add_argument("--files", type=int, default=1500)
    parser.add_argument("--containers", nargs="*", default=list(WRITERS))
    parser.add_argument("--keep", type=Path, help="folder for the files that crashed or lost samples")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    isolation.PATIENCE = PATIENCE_S
    outcomes = ("refused", "reported", "equal", "changed", "silent", "crashed")
    print(f"| container | {' | '.join(outcomes)} |\n|---|{'---|' * len(outcomes)}")
    total: Counter[str] = Counter()
    for number, name in enumerate(asked.containers):
        counts: Counter[str] = Counter()
        rng = np.random.default_rng([asked.seed, number])
        with tempfile.TemporaryDirectory() as folder:
            path = WRITERS[name](Path(folder), samples(N))
            data = path.read_bytes()
            sound = read(path, **OPTIONS)
            for place in range(asked.files // len(asked.containers)):
                kind = KINDS[place % len(KINDS)]
                path.write_bytes(damaged(data, kind, rng))
                outcome, text = outcome_of(path, sound, name)
                counts[outcome] += 1
                if outcome in {"silent", "crashed"}:
                    print(f"{name}, file {place}, {kind}: {outcome}: {text}")
                    if asked.keep:
                        asked.keep.mkdir(parents=True, exist_ok=True)
                        copy = asked.keep / f"{name.replace(', ', '_')}_{place}{path.suffix}"
                        copy.write_bytes(path.read_bytes())
        print(f"| {name} | {' | '.join(str(counts[outcome]) for outcome in outcomes)} |", flush=True)
        total += counts
    print(f"| all | {' | '.join(str(total[outcome]) for outcome in outcomes)} |")


if __name__ == "__main__":
    main()

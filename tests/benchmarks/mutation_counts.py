"""Count the outcomes of damaged logs of each format: samples, errors, and undesired outcomes.

    python tests/benchmarks/mutation_counts.py [cases] [format ...]

Each case applies one of four kinds of damage to a log, then reads and describes it. For each format the
script prints the number of cases that were read, refused with an error, ended with a foreign exception,
took more than 10 s, or printed lines from underlying packages.
"""

import contextlib
import os
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import scipy.io

from imucal.errors import ImucalError
from imucal.readers import describe, read
from tests.readers.containers.test_mutations import CHANGES
from tests.readers.logs import CONTAINERS, samples
from tests.readers.tables.texts import STYLES, write
from tests.readers.ulog.test_ulog import two_sensors

#: Seconds after which a case counts as a hang.
PATIENCE = 10
N = 60


class Hang(BaseException):
    """A case took too long."""


def columns() -> dict[str, np.ndarray[Any, Any]]:
    rng = np.random.default_rng(1)
    found: dict[str, np.ndarray[Any, Any]] = {"timestamp_ns": np.arange(N) * 10_000_000}
    for name, size, gravity in (("gyro", 1e-3, 0.0), ("accel", 1e-2, 9.8)):
        for axis in "xyz":
            found[f"{name}_{axis}"] = rng.normal(gravity * (axis == "z"), size, N)
    return found


def records() -> np.ndarray[Any, Any]:
    found = columns()
    table = np.zeros(N, dtype=[(name, values.dtype) for name, values in found.items()])
    for name, values in found.items():
        table[name] = values
    return table


def parquet(compression: Any) -> Callable[[Path], object]:  # noqa: ANN401 - names of polars
    return lambda path: pl.DataFrame(columns()).write_parquet(path, compression=compression)


TYPED: dict[str, tuple[str, Callable[[Path], object]]] = {
    "npy": ("log.npy", lambda path: np.save(path, records())),
    "npz": ("log.npz", lambda path: np.savez(path, **columns())),  # type: ignore[arg-type]
    "npz compressed": ("log.npz", lambda path: np.savez_compressed(path, **columns())),  # type: ignore[arg-type]
    "mat": ("log.mat", lambda path: scipy.io.savemat(path, columns())),
    "mat compressed": ("log.mat", lambda path: scipy.io.savemat(path, columns(), do_compression=True)),
    "mat 4": ("log.mat", lambda path: scipy.io.savemat(path, columns(), format="4")),
    "parquet": ("log.parquet", parquet("uncompressed")),
    "parquet snappy": ("log.parquet", parquet("snappy")),
    "parquet zstd": ("log.parquet", parquet("zstd")),
    "ulg": ("log.ulg", two_sensors),
}


def zero_much(data: bytearray, rng: np.random.Generator) -> None:
    """Fill a long run with zeros, like a crash of the file system."""
    at, size = int(rng.integers(len(data))), int(rng.integers(1, len(data) // 2))
    data[at : at + size] = bytes(min(size, len(data) - at))


def original(name: str, folder: Path) -> tuple[str, bytes]:
    """Return the file name and the bytes of a log of a format."""
    if name in TYPED:
        file, writer = TYPED[name]
        writer(folder / file)
        return file, (folder / file).read_bytes()
    if name in CONTAINERS:
        path = CONTAINERS[name](folder, samples(N))
        path = next(entry for entry in path.iterdir() if entry.suffix != ".yaml") if path.is_dir() else path
        return path.name, path.read_bytes()
    style = next(style for style in STYLES if style.name == name)
    path = write(style, folder)
    return path.name, path.read_bytes()


@contextlib.contextmanager
def silenced(count: Counter[str]) -> Iterator[None]:
    """Count output that bypasses Python's own streams."""
    with tempfile.TemporaryFile() as taken:
        kept = [os.dup(1), os.dup(2)]
        sys.stdout.flush()
        os.dup2(taken.fileno(), 1)
        os.dup2(taken.fileno(), 2)
        try:
            yield
        finally:
            sys.stdout.flush()
            for number, descriptor in enumerate(kept, 1):
                os.dup2(descriptor, number)
                os.close(descriptor)
            taken.seek(0)
            count["printed"] += taken.read().count(b"\n") > 0


def outcome(action: Callable[[Path], object], path: Path, count: Counter[str], kinds: Counter[str]) -> None:
    def late(*_: object) -> None:
        raise Hang

    signal.signal(signal.SIGALRM, late)
    signal.alarm(PATIENCE)
    try:
        with silenced(count):
            action(path)
        count["read"] += 1
    except ImucalError:
        count["refused"] += 1
    except Hang:
        count["hangs"] += 1
    except BaseException as error:  # noqa: BLE001 - panics of Rust are not Exceptions
        count["foreign"] += 1
        kinds[type(error).__name__] += 1
    finally:
        signal.alarm(0)


def main() -> None:
    warnings.simplefilter("ignore")
    cases = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    texts = ["EuRoC", "phyphox decimal comma", "ustime"]
    names = sys.argv[2:] or [*CONTAINERS, *texts, *TYPED]
    print(
        f"{'format':24} {'cases':>6} {'read':>6} {'refused':>8} {'foreign':>8} {'hangs':>6} {'prints':>7}  s"
    )
    total: Counter[str] = Counter()
    for name in names:
        count: Counter[str] = Counter()
        kinds: Counter[str] = Counter()
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            file, whole = original(name, Path(folder))
            path = Path(folder) / f"damaged-{file}"
            for case in range(cases):
                for number, change in enumerate((*CHANGES, zero_much)):
                    data = bytearray(whole)
                    change(data, np.random.default_rng([case, number]))
                    path.write_bytes(data)
                    count["cases"] += 1
                    outcome(read, path, count, kinds)
                    outcome(describe, path, count, kinds)
        total += count
        seen = ", ".join(f"{kind} {n}" for kind, n in kinds.most_common(4))
        print(row(name, count), f"{time.perf_counter() - start:.0f}  {seen}", flush=True)
    print(row("all", total))


def row(name: str, count: Counter[str]) -> str:
    return (
        f"{name:24} {count['cases']:6} {count['read']:6} {count['refused']:8} {count['foreign']:8} "
        f"{count['hangs']:6} {count['printed']:7} "
    )


if __name__ == "__main__":
    main()

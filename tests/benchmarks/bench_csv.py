"""Nanoseconds of CPU per row of a EuRoC CSV: imucal, the parser alone, np.loadtxt, np.genfromtxt.

Run: python tests/benchmarks/bench_csv.py [rows]
"""

import csv
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.csv_log import read
from imucal.readers.tables.text import open_text

HEADER = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
)
BEST_OF = 3
#: Rows that the slow peers read.
FEW = 100_000


def write(path: Path, rows: int) -> None:
    rng = np.random.default_rng(0)
    stamps = 1_403_715_273_262_142_976 + np.arange(rows) * 5_000_000
    samples = rng.normal(scale=0.01, size=(rows, 6)) + np.array([0, 0, 0, 0, 0, 9.8])
    with path.open("w", encoding="utf-8") as file:
        file.write(HEADER)
        for stamp, row in zip(stamps.tolist(), samples.tolist(), strict=True):
            file.write(f"{stamp},{','.join(map(repr, row))}\n")


def cpu_ns(job: Callable[[], object], rows: int) -> float:
    """Return the best of some runs, in ns of CPU per row."""
    best = float("inf")
    for _ in range(BEST_OF):
        start = time.process_time()
        job()
        best = min(best, time.process_time() - start)
    return best / rows * 1e9


def parser_alone(path: Path) -> None:
    import polars as pl

    schema = {str(i): pl.Float64 if i else pl.Int64 for i in range(7)}
    with open_text(path) as source:
        for block in source.blocks():
            whole = block.removeprefix(HEADER.encode())
            pl.read_csv(whole, has_header=False, schema=schema, quote_char=None)


def exact(path: Path) -> bool:
    """Return whether every sample is the number that Python's float makes of its text."""
    recording = read(path, ReadOptions())
    with path.open(encoding="utf-8") as file:
        rows = list(csv.reader(file))[1:]
    for i, series in enumerate(recording.series):
        if not np.array_equal(series.samples, np.array([float(row[i + 1]) for row in rows])):
            return False
    return True


def main(rows: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, short = Path(folder) / "long.csv", Path(folder) / "short.csv"
        write(path, rows)
        write(short, FEW)
        read(short, ReadOptions())  # imports
        print(
            f"{rows} rows, {path.stat().st_size / rows:.0f} bytes a row; bit-equal to Python: {exact(short)}"
        )
        ours = cpu_ns(lambda: read(path, ReadOptions()), rows)
        alone = cpu_ns(lambda: parser_alone(path), rows)
        loadtxt = cpu_ns(lambda: np.loadtxt(short, delimiter=",", skiprows=1), FEW)
        genfromtxt = cpu_ns(lambda: np.genfromtxt(short, delimiter=",", skip_header=1), FEW)
        print(f"imucal       {ours:7.0f} ns/row")
        print(f"polars alone {alone:7.0f} ns/row   imucal takes {ours / alone:.2f} times as long")
        print(f"np.loadtxt   {loadtxt:7.0f} ns/row   {loadtxt / ours:.1f} times imucal")
        print(f"genfromtxt   {genfromtxt:7.0f} ns/row   {genfromtxt / ours:.1f} times imucal")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2_000_000)

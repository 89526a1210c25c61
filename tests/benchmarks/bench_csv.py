"""Nanoseconds of CPU per row of a EuRoC CSV: imucal, the parser alone, np.loadtxt, np.genfromtxt.

    python -m tests.benchmarks.bench_csv [rows] [--engines]

`--engines` measures the parsers of other installed packages on the same text in memory, in blocks, with
given column types; CPU on one thread.
"""

import csv
import importlib
import importlib.util
import io
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.readers.tables.text_source import open_text

HEADER = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
)
BEST_OF = 3
#: Rows for the slow parsers.
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


#: Bytes of a block that an engine parses at once.
BLOCK = 4 << 20


def _package(name: str) -> Any:  # noqa: ANN401 - a third-party module
    return importlib.import_module(name)


def by_polars(block: bytes) -> list[Any]:
    import polars as pl

    schema = {str(i): pl.Float64 if i else pl.Int64 for i in range(7)}
    table = pl.read_csv(block, has_header=False, schema=schema, quote_char=None)
    return [column.to_numpy() for column in table]


def by_pyarrow(block: bytes) -> list[Any]:
    pa, arrow = _package("pyarrow"), _package("pyarrow.csv")

    types = {str(i): pa.float64() if i else pa.int64() for i in range(7)}
    table = arrow.read_csv(
        pa.BufferReader(block),
        read_options=arrow.ReadOptions(use_threads=False, column_names=list(types), block_size=1 << 20),
        convert_options=arrow.ConvertOptions(column_types=types, check_utf8=False),
        parse_options=arrow.ParseOptions(quote_char=False),
    )
    return [column.to_numpy() for column in table.columns]


def by_pandas(block: bytes) -> list[Any]:
    types = {i: np.float64 if i else np.int64 for i in range(7)}
    table = _package("pandas").read_csv(
        io.BytesIO(block), header=None, dtype=types, engine="c", na_filter=False
    )
    return [table[i].to_numpy() for i in range(7)]


def by_simdjson(block: bytes) -> list[Any]:
    """Parse the text as one JSON array, a quarter of a megabyte at a time, which fits the cache.

    Stamps lose their last digits, and rows with missing cells are not detected; both would cost more time.
    """
    parser, found, start = _package("simdjson").Parser(), [], 0
    while start < len(block):
        stop = block.rfind(b"\n", start, start + (1 << 18))
        document = parser.parse(b"[" + block[start:stop].replace(b"\n", b",") + b"]")
        found.append(np.frombuffer(document.as_buffer(of_type="d")).reshape(-1, 7).T.copy())
        del document
        start = stop + 1
    return found


def by_loadtxt(block: bytes) -> list[Any]:
    return [np.loadtxt(io.BytesIO(block), delimiter=",")]


#: Package -> its parser.
ENGINES: dict[str, Callable[[bytes], list[Any]]] = {
    "polars": by_polars,
    "pyarrow": by_pyarrow,
    "pandas": by_pandas,
    "simdjson": by_simdjson,
    "numpy": by_loadtxt,
}


def engines(path: Path) -> None:
    """Print the CPU time of each parser in ns per row."""
    text = path.read_bytes().partition(b"\n")[2]
    blocks, start = [], 0
    while start < len(text):
        stop = text.rfind(b"\n", start, start + BLOCK) + 1
        blocks.append(text[start:stop])
        start = stop
    spent = {}
    for name, parse in ENGINES.items():
        if importlib.util.find_spec(name) is not None:
            chosen = blocks[:1] if name == "numpy" else blocks
            rows = sum(block.count(b"\n") for block in chosen)
            parse(blocks[0])
            spent[name] = cpu_ns(lambda c=chosen, p=parse: [p(block) for block in c], rows)  # type: ignore[misc]
    print("\n| parser, alone | ns/row | `np.loadtxt` takes |\n|---|---|---|")
    for name, cost in sorted(spent.items(), key=lambda entry: entry[1]):
        print(f"| {name} | {cost:.0f} | {spent['numpy'] / cost:.1f} x |")


def exact(path: Path) -> bool:
    """Return whether every sample equals Python's float of its text."""
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
        if "--engines" in sys.argv:
            engines(path)


if __name__ == "__main__":
    # The limits must be set before the imports.
    os.environ |= {"POLARS_MAX_THREADS": "1", "IMUCAL_THREADS": "1", "OMP_NUM_THREADS": "1"}
    main(next((int(text) for text in sys.argv[1:] if text.isdecimal()), 2_000_000))

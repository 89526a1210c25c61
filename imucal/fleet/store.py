"""The store of a fleet: a folder of parquet parts for parallel writers, which remains valid after a crash.

A part is forced to disk and then renamed, so it is never incomplete. In a batch of three parts, the one in
``logs`` is written last and commits the others. No part is changed in place, so several runs can use one
store. Each file contains its checksum.
"""

import hashlib
import io
import itertools
import json
import secrets
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import polars as pl

from imucal.atomic import replacing, sweep, sync_folder
from imucal.errors import Fix, ReadError, StoreError, WriteError
from imucal.locks import locked

#: Results of a log. The first three depend on the log alone; the others may change in another run.
STATUSES = ("ok", "unreadable", "no-data", "memory", "timeout", "crash")

_TEXT, _REAL, _COUNT = pl.String(), pl.Float64(), pl.Int64()
#: Labels of a log, from the manifest or its path.
LABELS = {"model": _TEXT, "unit": _TEXT, "temperature_c": _REAL, "started": _TEXT}
#: One row per requested log; free columns of text may follow.
MANIFEST = {"path": _TEXT, **LABELS, "options": _TEXT, "copy_of": _TEXT}
#: One row per finished log. `reason` is the sentence of an error without the log's path, and `code` its name
#: for programs. `edge` is a checksum of size and both ends, `finished` a Unix time in s.
LOGS = {
    **dict.fromkeys(("key", "content", "edge", "path"), _TEXT),
    **LABELS,
    **dict.fromkeys(("status", "reason", "code", "verdict"), _TEXT),
    "findings": pl.List(_TEXT),
    "samples": _COUNT,
    **dict.fromkeys(("seconds", "rate_hz"), _REAL),
    **dict.fromkeys(("bytes", "mtime_ns"), _COUNT),
    **dict.fromkeys(("cpu_s", "wall_s", "finished"), _REAL),
    **dict.fromkeys(("report", "version"), _TEXT),
}
#: Stored fields of an `imucal.LogValue`.
OF_VALUE = ("value", "low", "high", "variance", "variance_sd", "variance_growth", "level", "correlation_time")
#: One row per log, axis and term; in SI.
RESULTS = {
    **dict.fromkeys(("key", "sensor", "axis", "term", "unit_si"), _TEXT),
    **dict.fromkeys(OF_VALUE, _REAL),
}
#: One row per log and axis: its binned spectrum.
BINS = {"key": _TEXT, "sensor": _TEXT, "axis": _TEXT, "bins": pl.Binary()}
#: Statistics of other rows (JSON); the key is a checksum of these rows.
DERIVED = {"key": _TEXT, "value": _TEXT}
#: The tables of a batch, in the order in which they are written; and all.
_OF_BATCH: dict[str, dict[str, Any]] = {"bins": BINS, "results": RESULTS, "logs": LOGS}
_TABLES: dict[str, dict[str, Any]] = {"derived": DERIVED, **_OF_BATCH}
_MANIFEST, _SETTINGS = "manifest.parquet", "settings.json"
#: Bytes of a checksum, and of the end of a parquet file (footer size and four letters).
_SEAL, _END = 32, 8
_NOT_WHOLE = "is damaged"

Row = Mapping[str, object]


class FleetStore:
    """The folder of a fleet: its manifest and the results of each log.

    Methods raise `WriteError` if a file can't be written or removed, and `StoreError` if a file is damaged.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    @property
    def exists(self) -> bool:
        return (self.folder / _MANIFEST).is_file()

    def create(self) -> None:
        """Make the folder, or check that it contains a fleet; remove remains of crashes.

        Raises `WriteError` also for a folder with other content.
        """
        begun = self.exists
        with suppress(StoreError):
            begun = begun or bool(self.settings())
        if self.folder.is_dir() and not begun:
            names = sorted({path.name for path in self.folder.iterdir()} - {_SETTINGS, *_TABLES})
            # Another run may start here, too: its scratch files and its lock begin with a dot.
            if strange := [name for name in names if not name.startswith(".")]:
                found = f"contains {', '.join(strange[:3])} but no imucal fleet"
                problem = f"{found}; nothing was changed"
                raise WriteError(problem, place=self.folder, fix=Fix("choose another folder"))
        with translated(self.folder):
            for name in _TABLES:
                (self.folder / name).mkdir(parents=True, exist_ok=True)
                sweep((self.folder / name).glob(".part-*"))

    def clear(self) -> None:
        """Remove every part and the manifest, but not the settings, which mark the folder of a fleet."""
        with translated(self.folder):
            # The commit records first: without them other parts are ignored.
            for path in (path for table in reversed(_TABLES) for path in self._parts(table)):
                path.unlink(missing_ok=True)
            shutil.rmtree(self.folder / "reports", ignore_errors=True)
            (self.folder / _MANIFEST).unlink(missing_ok=True)

    def settings(self) -> dict[str, object]:
        """Return the settings of all logs; empty if there are none."""
        path = self.folder / _SETTINGS
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            seal = found.pop("checksum")
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, AttributeError):
            found, seal = {}, None
        if seal != _digest(json.dumps(found).encode()).hex():
            raise StoreError(_NOT_WHOLE, place=path, fix=Fix("start the fleet again with --fresh"))
        return dict(found)

    def keep_settings(self, settings: Row) -> None:
        sealed = {**settings, "checksum": _digest(json.dumps(settings).encode()).hex()}
        with replacing(self.folder / _SETTINGS) as scratch:
            scratch.write_text(json.dumps(sealed, indent=2) + "\n", encoding="utf-8")

    def manifest(self) -> pl.DataFrame:
        """Return the requested logs, one row each; raises `ReadError` if there is no fleet."""
        path = self.folder / _MANIFEST
        try:
            if _is_whole(path, ()):
                return pl.read_parquet(path, glob=False)
        except OSError as error:
            found = "no such file" if isinstance(error, FileNotFoundError) else error.strerror or error
            problem = f"{found}; expected the folder of a fleet, written by imucal fleet run"
            raise ReadError(problem, place=path) from error
        fix = Fix("remove it and give the logs again: finished logs are kept")
        raise StoreError(_NOT_WHOLE, place=path, fix=fix)

    def add_to_manifest(self, rows: pl.DataFrame) -> pl.DataFrame:
        """Add logs to the manifest, or change their labels; return it."""
        with translated(self.folder), locked(self.folder / ".lock"):
            if self.exists:
                old = self.manifest()
                others = old.join(rows.select("path"), on="path", how="anti")
                rows = pl.concat([others, rows], how="diagonal")
                if rows.columns == old.columns and rows.sort("path").equals(old.sort("path")):
                    return old
            _write(self.folder / _MANIFEST, rows, ())
        return rows

    def changed_ns(self) -> int:
        """Return when logs or labels last changed, in ns since 1970."""
        return max((self.folder / name).stat().st_mtime_ns for name in (_MANIFEST, "logs"))

    def commit(
        self, logs: Iterable[Row], results: Iterable[Row] = (), bins: Iterable[Row] = (), *, shard: str = "0"
    ) -> str:
        """Write the results of some logs, all or nothing; return the name of the part."""
        name = f"part-{shard}-{secrets.token_hex(8)}.parquet"
        for table, rows in zip(_OF_BATCH, (bins, results, logs), strict=True):
            self._add(table, name, rows)
        return name

    def derived(self, keys: Collection[str]) -> dict[str, str]:
        found = self._read("derived", self._parts("derived"), pl.Series(keys, dtype=pl.String))
        return dict(found.select("key", "value").iter_rows())

    def keep_derived(self, found: Mapping[str, str]) -> None:
        with translated(self.folder):
            (self.folder / "derived").mkdir(exist_ok=True)
        rows = ({"key": key, "value": value} for key, value in found.items())
        self._add("derived", f"part-{secrets.token_hex(8)}.parquet", rows)

    def logs(self) -> pl.DataFrame:
        """Return the results of each log: the columns of `LOGS`, and `part`; sorted by path.

        Equal contents count once (the newest success, otherwise the newest failure), and so does a path.
        """
        found, newest = self._read("logs", self._parts("logs")), ("finished", "part")
        for one, order in (("key", (pl.col("status") == "ok", *newest)), ("path", newest)):
            found = found.sort(*order, descending=True).unique(one, keep="first", maintain_order=True)
        if self.exists:
            manifest = self.manifest()
            # The manifest contains the new path of a moved log.
            moved = manifest.filter(pl.col("copy_of").is_not_null()).with_columns(path="copy_of")
            labels = pl.concat([manifest, moved]).unique("path", keep="first", maintain_order=True)
            joined = found.join(labels.select("path", *LABELS), on="path", how="left", suffix="_new")
            kept = [pl.coalesce(f"{name}_new", name).alias(name) for name in LABELS]
            found = joined.with_columns(kept).select(found.columns)
        return found.sort("path")

    def results(self, logs: pl.DataFrame | None = None) -> pl.DataFrame:
        """Return one row per log, axis and term: `RESULTS`, and path, model, unit."""
        logs = self.logs() if logs is None else logs
        labels = logs.select("part", "key", "path", "model", "unit")
        found = self._rows_of("results", labels)
        columns = dict.fromkeys((*labels.columns[1:], *RESULTS))
        return found.select(*columns).sort("path", "sensor", "axis", "term")

    def bins(self, keys: Collection[str] | None = None) -> pl.DataFrame:
        """Return the binned spectra of all logs, or of those with the keys: the columns of `BINS`."""
        logs = self.logs().select("part", "key")
        own = logs if keys is None else logs.filter(pl.col("key").is_in(list(keys)))
        return self._rows_of("bins", own).sort("key", "sensor", "axis")

    def axes(self) -> pl.DataFrame:
        """Return the key, sensor and axis of each binned spectrum."""
        return self._rows_of("bins", self.logs().select("part", "key"), ("key", "sensor", "axis"))

    def damaged(self) -> dict[Path, list[Path]]:
        """Return the damaged parts, each with all parts of its batch, the commit record first."""
        batches = [part.name for part in self._parts("logs")]
        groups = [[self.folder / table / name for table in reversed(_OF_BATCH)] for name in batches]
        groups += [[path] for path in self._parts("derived")]
        every = ((path, group) for group in groups for path in group)
        return {path: group for path, group in every if not _is_whole(path, _TABLES[path.parent.name])}

    def refuse_damage(self) -> None:
        """Raise `StoreError` if a part is damaged."""
        for part in self.damaged():
            raise StoreError(_NOT_WHOLE, place=part, fix=Fix("run the fleet again to repeat its logs"))

    def mend(self) -> list[Path]:
        """Remove damaged batches, so that their logs are repeated; return the damaged parts."""
        damaged = self.damaged()
        with translated(self.folder):
            for path in itertools.chain.from_iterable(damaged.values()):
                if path.is_dir():
                    shutil.rmtree(path)
                path.unlink(missing_ok=True)
        return list(damaged)

    def _parts(self, table: str) -> list[Path]:
        return sorted((self.folder / table).glob("part-*.parquet"))

    def _add(self, table: str, name: str, rows: Iterable[Row]) -> None:
        schema = _TABLES[table]
        frame = pl.DataFrame([[row.get(c) for c in schema] for row in rows], schema=schema, orient="row")
        _write(self.folder / table / name, frame, schema)

    def _rows_of(self, table: str, logs: pl.DataFrame, columns: Collection[str] = ()) -> pl.DataFrame:
        """Return the rows of a table for `logs`, joined with their columns."""
        parts = [self.folder / table / name for name in logs["part"].unique()]
        return self._read(table, parts, logs["key"], columns).join(logs, on=["part", "key"]).drop("part")

    def _read(
        self, table: str, parts: list[Path], keys: pl.Series | None = None, columns: Collection[str] = ()
    ) -> pl.DataFrame:
        """Return columns (default: all) of parts of a table, for some keys, and the part of each row."""
        schema = {**_TABLES[table], "part": _TEXT}
        wanted = (*columns, "part") if columns else (*schema,)
        if not parts:
            return pl.DataFrame(schema=schema).select(wanted)
        rows = pl.scan_parquet(parts, include_file_paths="part", glob=False).select(wanted)
        rows = rows if keys is None else rows.filter(pl.col("key").is_in(keys.implode()))
        try:
            # Streaming, because parts with bins are large.
            found = rows.collect(engine="streaming")
        except (OSError, pl.exceptions.PolarsError) as error:
            why = (str(error) or type(error).__name__).splitlines()[0]
            problem = f"can't be read ({why})"
            raise StoreError(problem, place=self.folder / table, fix=Fix("run the fleet again")) from error
        return found.with_columns(pl.col("part").str.split("/").list.last())


def _write(path: Path, frame: pl.DataFrame, columns: Iterable[str]) -> None:
    stream = io.BytesIO()
    frame.write_parquet(stream, compression="zstd")
    data = stream.getvalue()
    footer = _footer_at(data)
    with replacing(path) as scratch:
        scratch.write_bytes(data[:footer] + _digest(data, columns) + data[footer:])
    sync_folder(path.parent)


def _digest(data: bytes, columns: Iterable[str] = ()) -> bytes:
    return hashlib.blake2b(data + ",".join(columns).encode(), digest_size=_SEAL).digest()


def _footer_at(data: bytes) -> int:
    """Return the start of a parquet file's footer; the checksum is before it, and ignored by readers."""
    return len(data) - _END - int.from_bytes(data[-_END:-4], "little")


def _is_whole(path: Path, columns: Iterable[str]) -> bool:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        if not columns:
            raise
        return False
    except IsADirectoryError:
        return False
    at = max(_footer_at(data), _SEAL)
    return data[at - _SEAL : at] == _digest(data[: at - _SEAL] + data[at:], columns)


@contextmanager
def translated(folder: Path) -> Iterator[None]:
    """Raise `WriteError` if a folder can't be written."""
    try:
        yield
    except OSError as error:
        why = error.strerror or error
        fix = Fix("free some space or choose another folder")
        raise WriteError(f"can't be written: {why}", place=folder, fix=fix) from error

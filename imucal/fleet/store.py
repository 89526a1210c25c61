"""The store of a fleet: files of JSON lines that only grow, one for each run.

Only the client of a run writes, so workers need no shared folder, and several runs may use one store. A line
begins with the CRC-32 of its text, so a damaged line is found and never counted. The first line of a file has
the settings and the requested logs; each other line has the results of one log. A killed run loses at most
the line that it was writing.
"""

import json
import os
import secrets
import shutil
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeAlias

from imucal.atomic import replacing, sync_folder
from imucal.errors import Fix, ReadError, StoreError, WriteError
from imucal.fleet.manifest import LABELS
from imucal.readers.foreign import FLEET_FILES
from imucal.report.typed_json import to_json

SCHEMA = "imucal/fleet-store/1"
#: Results of a log. The first three depend on the log alone; the others may change in another run.
STATUSES = ("ok", "unreadable", "no-data", "memory", "timeout", "crash")
#: Reports of single logs.
REPORTS = "reports"
#: Time in s after which a line without an end is not being written any more.
_WRITING_S = 0.2

#: The results of a log: its key, path, labels, status, sizes and times, and one value for each term.
LogRow: TypeAlias = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class AskedLog:
    """A requested log: path, labels, arguments of `imucal.read`, and the log of which it is a copy."""

    path: str
    labels: Mapping[str, str | float]
    reading: Mapping[str, Any]
    copy_of: str | None

    def as_json(self) -> dict[str, object]:
        return {
            "path": self.path,
            "labels": dict(self.labels),
            "reading": dict(self.reading),
            "copy_of": self.copy_of,
        }


@dataclass(frozen=True, kw_only=True)
class Stored:
    """The content of a store.

    `settings` are the noise model and the level of all fits. `asked` contains the requested logs by their
    paths. `rows` are the results of all logs in the order of their writing. `damaged` are lines, such as
    ``run-1.fleet:5``, of which no run knows yet.
    """

    folder: Path
    settings: Mapping[str, Any]
    asked: Mapping[str, AskedLog]
    rows: tuple[LogRow, ...]
    damaged: tuple[str, ...]

    def logs(self) -> list[LogRow]:
        """Return the rows that count, with their newest labels, sorted by path.

        Equal contents count once (the newest success, otherwise the newest failure), and so does a path.
        """
        by_key: dict[str, LogRow] = {}
        for row in sorted(self.rows, key=lambda row: (row["status"] == "ok", row["finished"])):
            by_key[row["key"]] = row
        by_path: dict[str, LogRow] = {}
        for row in sorted(by_key.values(), key=lambda row: row["finished"]):
            by_path[row["path"]] = row
        labels = {log.copy_of: log.labels for log in self.asked.values() if log.copy_of}
        labels |= {path: log.labels for path, log in self.asked.items()}
        return [
            row | {name: value for name, value in labels.get(path, {}).items() if name in LABELS}
            for path, row in sorted(by_path.items())
        ]

    def refuse_damage(self) -> None:
        """Raise StoreError if a line is damaged."""
        for line in self.damaged:
            problem = "is damaged, and does not count"
            fix = Fix("run the fleet again with the names of its logs: finished logs are kept")
            raise StoreError(problem, place=f"{self.folder}/{line}", fix=fix)


def is_fleet(folder: str | Path) -> bool:
    """Return whether a folder contains the store of a fleet."""
    return any(Path(folder).glob(FLEET_FILES))


def read_store(folder: str | Path) -> Stored:
    """Return the content of a store; raises ReadError if there is none, and StoreError without settings."""
    place = Path(folder)
    files = sorted(place.glob(FLEET_FILES))
    if not files:
        found = "no fleet in this folder" if place.is_dir() else "no such folder"
        raise ReadError(f"{found}; expected the folder of a fleet, written by imucal fleet run", place=place)
    settings: dict[str, Any] = {}
    asked: dict[str, AskedLog] = {}
    rows: list[LogRow] = []
    damaged: list[str] = []
    known: set[str] = set()
    for file in files:
        for number, line in enumerate(_lines(file), 1):
            content = _content(line)
            if content is None:
                damaged.append(f"{file.name}:{number}")
                continue
            settings = settings or content["settings"]
            if content["settings"] != settings:
                problem = f"has fits with {content['settings']}, other files of the fleet with {settings}"
                raise StoreError(problem, place=file, fix=Fix("move the files of one of them away"))
            known.update(content.get("damaged", ()))
            asked |= {row["path"]: AskedLog(**row) for row in content.get("asked", ())}
            if "log" in content:
                rows.append(content["log"])
    if not settings:
        problem = f"has no undamaged line of {len(damaged)}" if damaged else "is empty"
        fix = Fix("start the fleet again with --fresh")
        raise StoreError(problem, place=files[0], fix=fix)
    return Stored(
        folder=place,
        settings=settings,
        asked=asked,
        rows=tuple(rows),
        damaged=tuple(line for line in damaged if line not in known),
    )


def _lines(file: Path) -> list[bytes]:
    """Return the lines of a file; a last one without an end gets time to be finished."""
    try:
        data = file.read_bytes()
        if data and not data.endswith(b"\n"):
            time.sleep(_WRITING_S)
            data = file.read_bytes()
    except OSError as error:
        problem = f"can't be read: {error.strerror or error}"
        raise StoreError(
            problem, place=file, fix=Fix("make it readable, or choose another folder")
        ) from error
    lines = data.split(b"\n")
    # After the last end of a line there is nothing; otherwise the writer of the last line was killed.
    return lines if lines[-1] else lines[:-1]


def _content(line: bytes) -> dict[str, Any] | None:
    """Return the object of a line; None if it is damaged."""
    checksum, _, text = line.partition(b" ")
    if checksum != b"%08x" % zlib.crc32(text):
        return None
    content: dict[str, Any] = json.loads(text)
    return content if content.get("schema") == SCHEMA else None


def refuse_foreign(folder: Path) -> None:
    """Raise WriteError if a folder contains something else than a fleet."""
    with translated(folder):
        if folder.is_dir() and not is_fleet(folder):
            # Scratch files of another run begin with a dot.
            strange = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
            if strange:
                problem = f"contains {', '.join(strange[:3])} but no imucal fleet; nothing was changed"
                raise WriteError(problem, place=folder, fix=Fix("choose another folder"))


class RunFile:
    """The file of a run: `add` appends the results of a log and forces them to disk. Raises WriteError.

    `damaged` are the lines of the store that the run knows to be damaged: it repeats their logs.
    """

    def __init__(
        self,
        folder: Path,
        settings: Mapping[str, object],
        asked: Iterable[AskedLog] = (),
        damaged: Sequence[str] = (),
    ) -> None:
        refuse_foreign(folder)
        self._settings = dict(settings)
        # The names have the order of the beginnings of the runs.
        self.path = folder / f"run-{time.time_ns()}-{secrets.token_hex(4)}.fleet"
        with translated(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("xb", buffering=0)
        try:
            self._append({"asked": [log.as_json() for log in asked], "damaged": list(damaged)})
        except BaseException:
            # Without its first line the file is not one of a run.
            self._file.close()
            with suppress(OSError):
                self.path.unlink()
            raise
        sync_folder(folder)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def add(self, row: LogRow) -> None:
        """Append the results of a log, after the files of its own report."""
        files: Mapping[str, bytes] = row.get("files", {})
        if files:
            folder = self.path.parent / row["report"]
            with translated(folder):
                folder.mkdir(parents=True, exist_ok=True)
            for name, data in files.items():
                with replacing(folder / name) as scratch:
                    scratch.write_bytes(data)
        self._append({"log": {name: value for name, value in row.items() if name != "files"}})

    def forget_others(self) -> None:
        """Remove the files and reports of all other runs."""
        folder = self.path.parent
        with translated(folder):
            for path in folder.glob(FLEET_FILES):
                if path != self.path:
                    path.unlink(missing_ok=True)
            shutil.rmtree(folder / REPORTS, ignore_errors=True)

    def _append(self, content: Mapping[str, object]) -> None:
        document = {"schema": SCHEMA, "settings": self._settings, **content}
        text = json.dumps(to_json(document), allow_nan=False).encode()
        line = b"%08x %s\n" % (zlib.crc32(text), text)
        with translated(self.path):
            end = os.fstat(self._file.fileno()).st_size
            try:
                written = 0
                while written < len(line):
                    written += self._file.write(line[written:])
                os.fsync(self._file.fileno())
                # Otherwise a deleted file would take the results of hours.
                self.path.stat()
            except BaseException:
                with suppress(OSError):
                    self._file.seek(end)
                    self._file.truncate()
                raise


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Raise `WriteError` if a file or folder can't be written."""
    try:
        yield
    except OSError as error:
        why = error.strerror or error
        fix = Fix("free some space or choose another folder")
        raise WriteError(f"can't be written: {why}", place=path, fix=fix) from error

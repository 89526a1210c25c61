"""Write a folder of results so that it is complete, unchanged, or marked as incomplete."""

import errno
import json
import os
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from imucal.atomic import sweep, sync_folder
from imucal.errors import Fix, WriteError
from imucal.locks import locked

__all__ = ["FilesOfFolder", "OutFolder", "has_schema", "held_by", "home_of"]

_SCRATCH = re.compile(r"\.imucal-.*\.tmp")
_BEGUN = "begun.json"
_NAMED = 3


@dataclass(frozen=True, kw_only=True)
class OutFolder:
    """A folder of results that is written as a whole; other files in it are kept.

    `filling` first writes all files, and forces them to disk, in a scratch folder on the same file system. A
    new folder then appears in one step. In an existing one, each file is replaced in one step and the
    document comes last; until then it contains only its schema and the key ``incomplete``. An earlier
    failure changes nothing.

    - `what`: name of the results in messages, such as ``imucal report``
    - `document`: file that marks the folder as ours, with its `schema`
    - `own`: pattern of the names of all files that any version writes; `write` removes obsolete ones
    - `shared`: whether foreign files are accepted; the document is then missing while files are replaced
    """

    path: Path
    what: str
    document: str
    schema: str
    own: re.Pattern[str]
    shared: bool = False

    @property
    def _results(self) -> str:
        return f"the {self.what.removeprefix('imucal ')}"

    def refuse_foreign(self, names: Iterable[str] = ()) -> None:
        """Raise a WriteError for a foreign folder, or foreign files with these names."""
        with self.translated():
            # Look for files first: a folder of another run appears in one step.
            held = held_by(self.path)
            if held and not (self.shared or has_schema(self.path / self.document, self.schema)):
                problem = f"contains {held} but no {self.what}; nothing was changed"
                raise WriteError(problem, place=self.path, fix=Fix("choose another folder"))
            for name in names:
                if (file := self.path / name).is_dir():
                    problem = f"is a folder, expected a file of {self._results}"
                    raise WriteError(problem, place=file, fix=Fix("move it away"))

    def check(self) -> None:
        self.refuse_foreign()
        with self.translated():
            home = home_of(self.path)
            fine = {errno.ENOTDIR: home.is_dir(), errno.EACCES: os.access(home, os.W_OK | os.X_OK)}
            if wrong := [code for code in fine if not fine[code]]:
                raise OSError(wrong[0], os.strerror(wrong[0]))

    def write(self, contents: Mapping[str, bytes]) -> tuple[Path, ...]:
        """Write files; return their paths. Raises WriteError."""
        self.refuse_foreign(contents)
        with self.filling() as files:
            for name, content in contents.items():
                files.add(name, content)
        return files.paths

    @contextmanager
    def filling(self) -> Iterator["FilesOfFolder"]:
        """Yield a value that takes the files one by one; they appear at the end of the block.

        An exception in the block changes nothing. Raises WriteError.
        """
        self.refuse_foreign()
        with self.translated():
            scratch = self._new_scratch()
        try:
            files = FilesOfFolder(self, scratch)
            yield files
            with self.translated():
                sync_folder(scratch)
                self._publish(scratch, files.names)
        finally:
            with suppress(OSError):
                shutil.rmtree(scratch)

    @contextmanager
    def translated(self) -> Iterator[None]:
        """Raise a WriteError for an OSError."""
        try:
            yield
        except OSError as error:
            reason = error.strerror or str(error)
            advice = {
                **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "free some space"),
                **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "choose a folder you may write to"),
            }.get(error.errno or 0, "choose another folder")
            problem = f"{self._results} can't be written: {reason}"
            problem = f"{problem}; nothing was changed"
            raise WriteError(problem, place=self.path, fix=Fix(advice)) from error

    def _new_scratch(self) -> Path:
        home = self.path if self.path.is_dir() else self.path.parent
        home.mkdir(parents=True, exist_ok=True)
        sweep(path for path in home.iterdir() if _SCRATCH.fullmatch(path.name))
        folder = home / f".imucal-{secrets.token_hex(8)}.tmp"
        # Unlike mkdtemp, mkdir respects the user's umask.
        folder.mkdir()
        return folder

    def _publish(self, scratch: Path, names: Sequence[str]) -> None:
        if not self.path.exists():
            try:
                scratch.rename(self.path)
            except OSError:
                if not self.path.is_dir():
                    raise
            else:
                sync_folder(self.path.parent)
                return
        moved = 0
        try:
            with locked(self.path / ".lock" if self.shared else self.path):
                self._mark_incomplete(scratch)
                others = [name for name in names if name != self.document]
                for moved, name in enumerate((*others, self.document)):  # noqa: B007 - for the message
                    (scratch / name).replace(self.path / name)
                for path in self.path.iterdir():
                    if self.own.fullmatch(path.name) and path.name not in names and path.is_file():
                        path.unlink()
        except OSError as error:
            problem = f"only {moved} of {len(names)} files were replaced: {error.strerror or error}"
            problem = f"{problem}; {self._results} is incomplete"
            raise WriteError(problem, place=self.path, fix=Fix("write it again")) from error
        sync_folder(self.path)

    def _mark_incomplete(self, scratch: Path) -> None:
        if self.shared:
            (self.path / self.document).unlink(missing_ok=True)
            return
        text = f"its files were being replaced; write {self._results} again"
        _write(scratch / _BEGUN, json.dumps({"schema": self.schema, "incomplete": text}).encode())
        (scratch / _BEGUN).replace(self.path / self.document)


class FilesOfFolder:
    """The files that a block of `OutFolder.filling` has written so far."""

    def __init__(self, folder: OutFolder, scratch: Path) -> None:
        self.folder = folder
        self.names: list[str] = []
        self._scratch = scratch

    def add(self, name: str, content: bytes) -> Path:
        """Write a file and force it to disk; return the path at which it will appear."""
        with self.folder.translated():
            _write(self._scratch / name, content)
        self.names.append(name)
        return self.folder.path / name

    @property
    def paths(self) -> tuple[Path, ...]:
        """The paths of all files, in the order in which they were written."""
        return tuple(self.folder.path / name for name in self.names)


def has_schema(path: Path, schema: str) -> bool:
    """Return whether a file is a JSON document of the schema, in any version."""
    try:
        found = json.loads(path.read_bytes()).get("schema")
    except (OSError, ValueError, AttributeError):
        return False
    return isinstance(found, str) and found.rpartition("/")[0] == schema.rpartition("/")[0]


def held_by(out: Path) -> str:
    """Return the first names in a folder; a WriteError if it is a file."""
    if not os.path.lexists(out):
        return ""
    if not out.is_dir():
        msg = f"{out}: is a file, expected a folder or nothing; move it away or choose another folder"
        raise WriteError(msg)
    entries = sorted(path.name for path in out.iterdir() if not _SCRATCH.fullmatch(path.name))
    return ", ".join(entries[:_NAMED]) + (", …" if len(entries) > _NAMED else "")


def home_of(out: Path) -> Path:
    """Return the path if it exists, otherwise the nearest folder above it."""
    return next(folder for folder in (out, *out.absolute().parents) if folder.exists())


def _write(path: Path, content: bytes) -> None:
    with path.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())

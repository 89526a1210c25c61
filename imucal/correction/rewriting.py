"""Apply a calibration to a log: read what its samples are, then copy it with corrected samples."""

import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from imucal.atomic import replacing
from imucal.calibration.applying import Correction, refuse_unlike
from imucal.calibration.document import Intrinsics
from imucal.correction import bias_over_time
from imucal.correction.bias_over_time import BiasOverTime
from imucal.correction.job import AlreadyCorrectedError, Job, mark_file, mark_text
from imucal.correction.mcap_file import rewrite_mcap
from imucal.correction.messages import MessageCorrection
from imucal.correction.ros1_file import rewrite_ros1
from imucal.correction.sqlite_file import rewrite_sqlite
from imucal.correction.targets import targets_of
from imucal.correction.text_file import TableCorrection, rewrite_text
from imucal.errors import ArgumentError, DataError, Fix, ReadError, WriteError
from imucal.findings import Finding
from imucal.readers.assemble import DAMAGE, assemble
from imucal.readers.choose import choose
from imucal.readers.compression import unpack_file
from imucal.readers.containers.container import Container
from imucal.readers.files import DamagedError, naming
from imucal.readers.formats import open_log
from imucal.readers.message_logs import MessageLog
from imucal.readers.read_options import Progress, ReadOptions
from imucal.readers.table import Log
from imucal.readers.tables.text_table import TextLog
from imucal.recording import Recording
from imucal.temperature.result import Thermal

#: Endings of files that are compressed as a whole.
_ZSTD = (".zst", ".zstd")


#: Suffix of a file -> its format. Text tables have many suffixes.
_FORMATS = {
    ".mcap": "MCAP",
    ".bag": "ROS 1 bag",
    ".db3": "SQLite",
    ".csv": "text",
    ".tsv": "text",
    ".txt": "text",
}


@dataclass(frozen=True, kw_only=True)
class AppliedLog:
    """A corrected log: its file or folder, the original, the corrected topics or columns, and findings."""

    path: Path
    original: str
    corrected: tuple[str, ...]
    samples: int
    findings: tuple[Finding, ...]


def apply_to_log(
    calibration: Intrinsics | Thermal, path: Path, out: Path, options: ReadOptions
) -> AppliedLog:
    """Write a copy of a log with corrected samples; everything else stays byte for byte.

    Raises DataError if the log and the calibration do not fit, or the log is damaged or already corrected;
    ReadError if it can't be read or its format can't be written; WriteError if `out` exists or can't be
    written; ArgumentError if `out` has the suffix of another format; ChoiceError as reading does.
    """
    _refuse_suffix(path, out)
    if out.exists():
        raise WriteError("exists already", place=out, fix=Fix("choose another name, or remove it"))
    if mark_file(path).exists():
        raise _corrected_before(path)
    read, write = _halves(options.progress)
    first = replace(options, progress=read)
    with open_log(path, first) as log, naming(path):
        choices = choose(log, first)
        recording = assemble(log, choices, first)
        _refuse_damage(recording)
        findings, correction = _correction(calibration, recording, log)
        targets = targets_of(choices, recording)
        mark = mark_text(calibration.source.name if isinstance(calibration, Thermal) else calibration.source)
        with replacing(out) as scratch, _damage_refused(path):
            size = log.size_bytes or 0

            def done(count: int) -> None:
                if write is not None:
                    write(min(count, size), size)

            if isinstance(log, MessageLog):
                messages = MessageCorrection(log, targets, correction)
                _rewrite_messages(log, path, scratch, messages, mark=mark, progress=done)
            elif isinstance(log, TextLog):
                table = TableCorrection(
                    layout=log.layout_of(targets[0].table), targets=targets, correction=correction
                )
                _rewrite_table(log, path, scratch, table, done)
            else:
                raise _unwritable(log, path)
        if isinstance(log, TextLog):
            with replacing(mark_file(out)) as note:
                note.write_text(mark + "\n", encoding="utf-8")
    return AppliedLog(
        path=out,
        original=recording.source.path,
        corrected=recording.source.topics,
        samples=max(series.n for series in recording.series),
        findings=(*recording.findings, *findings),
    )


def _correction(
    calibration: Intrinsics | Thermal, recording: Recording, log: Log
) -> tuple[tuple[Finding, ...], Correction | BiasOverTime]:
    """Return doubts about the pair, and what corrects the samples."""
    if isinstance(calibration, Intrinsics):
        return refuse_unlike(calibration, recording), Correction.of(calibration)
    doubts = bias_over_time.refuse_unlike(calibration, recording, table=isinstance(log, TextLog))
    return doubts, BiasOverTime.of(calibration, recording)


def _refuse_suffix(path: Path, out: Path) -> None:
    """Raise ArgumentError if the name of the corrected log states another format than it has."""
    own = _FORMATS.get(path.suffix.lower())
    named = _FORMATS.get(out.suffix.lower())
    if named is not None and own is not None and named != own:
        problem = f"names the format {named}, and the corrected log has the format of the log, {own}"
        raise ArgumentError(problem, place=out, fix=Fix(f"name it {out.with_suffix(path.suffix).name}"))


def _halves(progress: Progress | None) -> tuple[Progress | None, Progress | None]:
    """Return the progress of reading and that of writing, which is the second half."""
    if progress is None:
        return None, None

    def read(done: int, total: int) -> None:
        progress(done, 2 * total)

    def write(done: int, total: int) -> None:
        progress(total + done, 2 * total)

    return read, write


def _corrected_before(path: Path) -> DataError:
    return DataError("it is already corrected", place=path, fix=Fix("give the original log"))


def _unwritable(log: Log, path: Path) -> ReadError:
    problem = f"the format {log.form} can't be written; expected MCAP, a ROS bag, or a text table"
    return ReadError(problem, place=path, fix=Fix("convert it first"))


def _refuse_damage(recording: Recording) -> None:
    for finding in recording.findings:
        # A file of messages without an index is read from its start, as here.
        if finding.code in DAMAGE - {"unindexed"}:
            problem = f"is damaged: {finding.text}"
            fix = Fix("repair it first, such as with `mcap recover` or `rosbag reindex`")
            raise DataError(problem, place=recording.source.path, fix=fix)


@contextmanager
def _damage_refused(path: Path) -> Iterator[None]:
    """Raise DataError for a damaged or corrected log."""
    try:
        yield
    except AlreadyCorrectedError as error:
        raise _corrected_before(path) from error
    except (DamagedError, sqlite3.Error) as error:
        raise DataError(f"is damaged: {error}", place=path, fix=Fix("repair it first")) from error


def _rewrite_messages(
    log: MessageLog,
    path: Path,
    scratch: Path,
    messages: MessageCorrection,
    *,
    mark: str,
    progress: Callable[[int], None],
) -> None:
    """Write the files of a log of messages; a folder keeps its other files."""
    before = 0
    if path.is_dir():
        names = {container.path.name for container in log.containers}
        shutil.copytree(path, scratch, ignore=lambda _, found: [name for name in found if name in names])
    for number, container in enumerate(log.containers):
        target = scratch / container.path.name if path.is_dir() else scratch

        def done(read: int, before: int = before) -> None:
            progress(before + read)

        patch = partial(messages.patch, number)
        job = Job(keys=messages.keys(number), patch=patch, mark=mark, progress=done)
        _rewrite_container(container, target, job)
        before += container.size


def _rewrite_container(container: Container, target: Path, job: Job) -> None:
    source = container.path
    if source.name.endswith(_ZSTD):
        _rewrite_packed(container, target, job)
    elif container.compression.startswith("zstd, each message") and container.format == "mcap":
        problem = "the messages of this MCAP file are compressed one by one"
        raise DataError(problem, place=source, fix=Fix("convert it with `ros2 bag convert`"))
    else:
        _rewrite_plain(container, source, target, job)


def _rewrite_plain(container: Container, source: Path, target: Path, job: Job) -> None:
    if container.format == "rosbag2-sqlite3":
        rewrite_sqlite(source, target, job, zstd=container.compression == "zstd, each message")
        return
    rewrite = rewrite_ros1 if container.format == "rosbag1" else rewrite_mcap
    with source.open("rb") as old, target.open("wb") as new:
        rewrite(old, new, job)


def _rewrite_packed(container: Container, target: Path, job: Job) -> None:
    """Rewrite a file that is compressed as a whole."""
    import zstandard

    with tempfile.TemporaryDirectory(prefix="imucal-") as folder:
        plain = Path(folder) / "plain"
        corrected = Path(folder) / "corrected"
        with plain.open("wb") as file:
            unpack_file(container.path, file, lambda _: None)
        _rewrite_plain(container, plain, corrected, replace(job, progress=lambda _: None))
        with corrected.open("rb") as source, target.open("wb") as file:
            # A frame states its size, as those of rosbag2 do.
            size = corrected.stat().st_size
            zstandard.ZstdCompressor().copy_stream(source, file, size=size)
    job.progress(container.size)


def _rewrite_table(
    log: TextLog, path: Path, scratch: Path, table: TableCorrection, progress: Callable[[int], None]
) -> None:
    if not path.is_file() or log.compression != "none":
        problem = "expected one plain text file with both sensors in each row"
        raise DataError(problem, place=path, fix=Fix("unpack or join it first"))
    with path.open("rb") as source, scratch.open("wb") as target:
        rewrite_text(source, target, table, progress)

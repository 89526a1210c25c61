"""Describe a remote log from its index: some hundred kB instead of the file."""

from collections.abc import Callable, Sequence
from pathlib import Path

from imucal.readers.containers import Container
from imucal.readers.containers.mcap import McapFile
from imucal.readers.containers.ros1 import BagFile
from imucal.readers.containers.ros2_bag import mcap_part, open_parts
from imucal.readers.containers.rosbag2_folder import METADATA, folder_of, require_metadata_size
from imucal.readers.contents import LogContents
from imucal.readers.files import LogFile
from imucal.readers.formats import detect_head
from imucal.readers.message_logs import describe_logs
from imucal.readers.read_options import ReadOptions
from imucal.readers.remote_logs import LocalLogs, RangedFile, TooMuchError
from imucal.remote import RemoteLog
from imucal.remote.addresses import ChangedError, RemoteFile
from imucal.remote.copies import LocalCopy, entry_of

#: Smaller logs, in bytes, are downloaded: parts would take as long.
_SMALL = 1 << 20
_HEAD = 4096
_INDEXED: dict[str, Callable[[Path, LogFile], Container]] = {"MCAP": McapFile, "ROS 1 bag": BagFile}


def index_of(log: RemoteLog, options: ReadOptions) -> LogContents | None:
    """Return the contents of a log from its index alone; None if that saves nothing or is impossible."""
    entry = entry_of(log)
    if (log.size or 0) < _SMALL or entry.is_whole(log):
        return None
    path, files = entry.path(log), entry.files(log, entry.whole)
    named = LocalLogs((path,), (LocalCopy(log=log, path=path, files=tuple(files)),))
    try:
        with named.errors_named():
            opened = _bag(log, path, files) if log.folder else _file(log.files[0], path)
            if opened is None:
                return None
            containers, form = opened
            return named.with_urls(describe_logs(containers, path, options, form=form))
    except (TooMuchError, ChangedError):
        return None


def _file(remote: RemoteFile, path: Path) -> tuple[list[Container], str] | None:
    file = RangedFile(remote, path)
    format_ = detect_head(path, bytes(file.read(0, _HEAD)))
    if format_.name not in _INDEXED:
        return None
    container = _INDEXED[format_.name](path, file)
    return [container], container.format


def _bag(log: RemoteLog, path: Path, files: Sequence[Path]) -> tuple[list[Container], str] | None:
    remote = dict(zip(files, log.files, strict=True))
    metadata = remote.pop(path / METADATA, None)
    if metadata is None or any(file.suffix != ".mcap" for file in remote):
        return None
    require_metadata_size(path / METADATA, metadata.size or 0)
    text = bytes(RangedFile(metadata, path).read(0, metadata.size or 0)).decode("utf-8", "replace")
    folder = folder_of(path, [file.name for file in files], text)
    containers, _ = open_parts(
        folder, lambda file: mcap_part(folder, McapFile(file, RangedFile(remote[file], file)))
    )
    return containers, "rosbag2-mcap"

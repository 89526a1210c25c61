"""What is in a remote log, from its index: some hundred kB instead of the file."""

from collections.abc import Callable
from pathlib import Path

from imucal.readers.containers import Container
from imucal.readers.containers.mcap_file import McapFile
from imucal.readers.containers.ros1_file import BagFile
from imucal.readers.contents import LogContents
from imucal.readers.files import LogFile
from imucal.readers.formats import detect_head
from imucal.readers.message_logs import describe_logs
from imucal.readers.ranged_file import RangedFile, TooMuchError
from imucal.readers.read_options import ReadOptions
from imucal.readers.remote_logs import LocalLogs
from imucal.remote import LocalCopy, RemoteLog
from imucal.remote.failures import ChangedError
from imucal.remote.log_cache import entry_of

#: Below this many bytes a log is downloaded for its description too: its parts would take no less time.
_SMALL = 1 << 20
#: First bytes that tell a format.
_HEAD = 4096
#: Formats whose description is read from the index.
_INDEXED: dict[str, Callable[[Path, LogFile], Container]] = {"MCAP": McapFile, "ROS 1 bag": BagFile}


def index_of(log: RemoteLog, options: ReadOptions) -> LogContents | None:
    """Return what is in a log by reading its index alone, some hundred kB.

    None where that saves nothing: a small or cached log, a format without an index, a damaged index, a
    server that gives no parts.
    """
    entry = entry_of(log)
    if log.folder or (log.size or 0) < _SMALL or entry.is_whole(log):
        return None
    path = entry.path(log)
    named = LocalLogs((path,), (LocalCopy(log=log, path=path, files=(path,)),))
    try:
        with named.errors_named():
            file = RangedFile(log.files[0], path)
            format_ = detect_head(path, bytes(file.read(0, _HEAD)))
            if format_.name not in _INDEXED:
                return None
            container = _INDEXED[format_.name](path, file)
            return named.described(describe_logs([container], path, options, form=container.format))
    except (TooMuchError, ChangedError):
        return None

"""URL -> the logs that it stands for, and the identity of each."""

from contextlib import suppress

from imucal.errors import ReadError
from imucal.remote.addresses import has_wildcards, is_folder_name, name_of, shown
from imucal.remote.remote_log import RemoteFile, RemoteLog
from imucal.remote.stores import Store, store_of

#: The file that makes a folder a bag.
_METADATA = "metadata.yaml"
#: Endings of logs; a compressed text may have one more.
_MESSAGES = (".mcap", ".bag", ".db3", ".bag.active", ".mcap.zstd", ".mcap.zst", ".db3.zstd", ".db3.zst")
_TABLES = (".csv", ".tsv", ".txt", ".log", ".dat", ".parquet", ".npz", ".npy", ".mat", ".ulg")
_PACKED = ("", ".gz", ".bz2", ".xz", ".zst", ".zstd", ".zip")
_LOGS = (*_MESSAGES, *(table + packed for table in _TABLES for packed in _PACKED))


def expand(url: str) -> list[str]:
    """Return the URLs of the logs that one stands for: itself, what its wildcards match, or a folder's logs.

    A folder with ``metadata.yaml`` is one log, the bag of ROS 2; so is one that holds only tables, as
    they may be an app's set. Of any other, each log stands for itself.

    Raises
    ------
    ReadError
        If there is none, or it can't be asked.
    """
    store = store_of(url)
    if not has_wildcards(url) and not is_folder_name(url) and store.look_at(url) is not None:
        return [url]
    return _expanded(store, url)


def logs_at(url: str) -> list[RemoteLog]:
    """Return the logs that a URL stands for, as `expand` does, with what `identify` says of each."""
    store = store_of(url)
    if not has_wildcards(url) and not is_folder_name(url) and (file := store.look_at(url)) is not None:
        return [_of_one(url, file)]
    return [identify(log) for log in _expanded(store, url)]


def _expanded(store: Store, url: str) -> list[str]:
    if has_wildcards(url):
        found = [match for match in store.matches(url) if name_of(match).endswith(_LOGS)]
        if found:
            return found
        with suppress(ReadError):
            # Such signs may stand in a name.
            if store.look_at(url) is not None:
                return [url]
        msg = f"{shown(url)}: no log has such a name; expected one with an ending such as .mcap, .bag or .csv"
        raise ReadError(msg)
    logs = _logs_in(store, url)
    names = [name_of(log) for log in logs]
    if _METADATA in names or not any(name.endswith(_MESSAGES) for name in names):
        return [url]
    return [log for log in logs if name_of(log).endswith(_MESSAGES)]


def identify(url: str, *, keep: bool = True) -> RemoteLog:
    """Return name, ETag and size of a log without reading it; `keep` says whether its copy stays after use.

    Raises
    ------
    ReadError
        If there is none, it may not be read, or the store can't be asked.
    """
    store = store_of(url)
    file = None if is_folder_name(url) else store.look_at(url)
    if file is not None:
        return _of_one(url, file, keep=keep)
    found = [store.look_at(log) for log in _logs_in(store, url)]
    return RemoteLog(url=url, files=tuple(file for file in found if file is not None), folder=True, keep=keep)


def _of_one(url: str, file: RemoteFile, *, keep: bool = True) -> RemoteLog:
    if file.size == 0:
        msg = f"{shown(url)}: the file is empty; expected a log"
        raise ReadError(msg)
    return RemoteLog(url=url, files=(file,), keep=keep)


def _logs_in(store: Store, url: str) -> list[str]:
    """Return the files of a folder that belong to logs.

    Raises
    ------
    ReadError
        If there are none.
    """
    files = store.files_in(url)
    logs = [file for file in files if name_of(file) == _METADATA or name_of(file).endswith(_LOGS)]
    if not any(name_of(log) != _METADATA for log in logs):
        inside = ", ".join(name_of(file) for file in files[:10]) or "nothing"
        msg = f"{shown(url)}: a folder that holds {inside}; expected logs, such as .mcap, .bag or .csv files"
        raise ReadError(msg)
    return logs

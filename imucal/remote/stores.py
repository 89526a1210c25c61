"""Stores of logs, by fsspec: web servers, S3, Google Cloud Storage and Azure."""

import functools
import importlib.util
import logging
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from fnmatch import fnmatchcase
from html import unescape
from typing import IO, TYPE_CHECKING, Any, TypeVar
from urllib.parse import quote, unquote, urlunsplit

from imucal._version import __version__
from imucal.errors import ArgumentError, ReadError, SettingError
from imucal.parallel import DOWNLOADS
from imucal.remote.addresses import (
    PACKAGES,
    WEB,
    RemoteFile,
    RemoteLog,
    has_wildcards,
    is_folder_name,
    name_of,
    refused,
    scheme_of,
    split_web,
)
from imucal.remote.failures import PassingError, explained
from imucal.user_input import seconds_of

if TYPE_CHECKING:
    from asyncio import AbstractEventLoop

Result = TypeVar("Result")

TIMEOUT = "IMUCAL_REMOTE_TIMEOUT"
#: Default timeout in s.
_DEFAULT_TIMEOUT_S = 30.0
#: Seconds before each further attempt of a request.
WAITS = (0.5, 1.0, 2.0)
#: The libraries of the other stores retry.
_RETRIED_HERE = WEB | {"s3", "s3a"}
#: Bytes per request of a download. Smaller parts cost time, larger ones are lost with a broken connection.
PART = 1 << 24
#: Bytes per read of an answer that can't be requested in parts.
_BLOCK = 1 << 20
#: Package -> extra of imucal that contains it.
EXTRAS = {"aiohttp": "remote", "s3fs": "s3", "gcsfs": "gcs", "adlfs": "azure"}
#: Characters of a web address that stay, also quoted ones: another spelling may have another signature.
_SAFE = "%/?:@!$&'()*+,;=~-._"
_PAGE_STARTS = (b"<!doctype html", b"<html")


def timeout() -> float:
    """Return the timeout in s from ``IMUCAL_REMOTE_TIMEOUT``; raises SettingError if it is invalid."""
    text = os.environ.get(TIMEOUT, "").strip()
    if not text:
        return _DEFAULT_TIMEOUT_S
    try:
        seconds = seconds_of(text)
    except ArgumentError:
        seconds = 0.0
    if not 0 < seconds < 1e6:
        raise SettingError(f"{TIMEOUT}: found {text!r}, expected seconds such as 60; set some, or unset it")
    return seconds


class _WholeOnlyError(Exception):
    """The server does not send parts of files."""


class Store:
    """The file system of a URL. Methods raise ReadError."""

    def __init__(self, url: str) -> None:
        self._scheme = scheme_of(url)
        if self._scheme not in PACKAGES:
            hint = "; omit file://" if self._scheme == "file" else ""
            problem = f"{self._scheme}:// is not supported"
            expected = "expected s3://, gs://, az://, abfs://, https:// or http://"
            raise refused(url, f"{problem}; {expected}{hint}")
        for package in ("fsspec", PACKAGES[self._scheme]):
            if importlib.util.find_spec(package) is None:
                extra = EXTRAS[PACKAGES[self._scheme]]
                raise refused(url, "needs another package", f"type: pip install 'imucal-noise[{extra}]'")
        self._web = self._scheme in WEB
        self._files = self._asked(url, lambda: _file_system(self._scheme))

    def look_at(self, url: str) -> RemoteFile | None:
        """Return an object without reading it; None for a folder."""
        if self._web and is_folder_name(url):
            return None
        info = self._asked(url, lambda: self._files.info(self._key(url)))
        if info.get("type") == "directory":
            return None
        size = info.get("size")
        if self._web:
            # Some servers answer a question about any file with a length of zero.
            size = size or None
        elif size is None:
            raise refused(url, "its store does not report its size; expected an object of known size")
        return RemoteFile(url=url, etag=_entity_tag(info), size=size)

    def read(self, file: RemoteFile, start: int, stop: int) -> bytes:
        """Return some bytes of an object of known size."""
        try:
            return self._asked(file.url, lambda: self._part(file, start, stop))
        except _WholeOnlyError as error:
            raise refused(file.url, "its server sends no parts of files") from error

    def download(self, file: RemoteFile, out: IO[bytes], count: Callable[[int], None]) -> None:
        """Write an object to an open file; a part that fails is requested again.

        `count` is called with the number of bytes written. Raises ReadError also if the object has changed.
        """
        size, whole = file.size or 0, file.size is None
        try:
            for start in range(0, size, PART):
                stop = min(start + PART, size)
                data = self._asked(file.url, functools.partial(self._part, file, start, stop))
                if start == 0:
                    self._require_no_page(file, data)
                out.write(data)
                count(stop)
        except _WholeOnlyError:
            whole = True
        if whole:
            self._asked(file.url, lambda: self._stream(file, out, count))
        # Parts may belong to two objects.
        if self.look_at(file.url) != file:
            raise changed(file.url)

    def files_in(self, url: str) -> list[str]:
        """Return the URLs of the files of a folder, sorted."""
        if not self._web:
            listed = self._asked(url, lambda: self._files.ls(self._key(url), detail=True))
            return sorted(self._url(entry["name"]) for entry in listed if entry.get("type") == "file")
        return self._links(url, url.partition("?")[0].rstrip("/") + "/")

    def matches(self, url: str) -> list[str]:
        """Return the URLs that match wildcards, sorted; in a web address only in its last part."""
        if not self._web:
            return sorted(map(self._url, self._asked(url, lambda: self._files.glob(self._key(url)))))
        folder, _, pattern = url.partition("?")[0].rpartition("/")
        if "*" in folder:
            raise refused(url, "a web address may have * in its last part only, such as …/logs/*.mcap")
        links = self._links(url, f"{folder}/")
        return [link for link in links if fnmatchcase(name_of(link), unquote(pattern))]

    def _links(self, url: str, folder: str) -> list[str]:
        """Return the links to files directly in a folder of a web server, sorted."""
        if split_web(url).query:
            raise refused(url, "a folder or * with a query; expected the address of a log, or no query")
        key = self._key(folder)
        found = map(unescape, self._asked(url, lambda: self._files.ls(key, detail=False)))
        # A link must not make imucal ask another server, which would get this user's password.
        names = {link: link.partition("?")[0].removeprefix(key) for link in found if link.startswith(key)}
        return sorted(link for link, name in names.items() if name and "/" not in name)

    def _part(self, file: RemoteFile, start: int, stop: int) -> bytes:
        key = self._key(file.url)
        if self._web:
            # A server without ranges answers with the whole file, of which cat_file would read all.
            with self._files.open(key, size=file.size, block_size=PART, cache_type="none") as source:
                source.seek(start)
                try:
                    data: bytes = source.read(stop - start)
                except ValueError as error:
                    raise _WholeOnlyError from error
        else:
            data = self._files.cat_file(key, start=start, end=stop)
        if len(data) != stop - start:
            raise changed(file.url)
        return data

    def _stream(self, file: RemoteFile, out: IO[bytes], count: Callable[[int], None]) -> None:
        """Write an object that can't be requested in parts."""
        out.seek(0)
        out.truncate()
        done = 0
        with self._files.open(self._key(file.url), size=file.size, block_size=0) as source:
            while block := source.read(_BLOCK):
                if done == 0:
                    self._require_no_page(file, block)
                out.write(block)
                done += len(block)
                count(done)
        if done == 0:
            raise empty(file.url)
        if file.size not in {None, done}:
            raise changed(file.url)

    def _require_no_page(self, file: RemoteFile, head: bytes) -> None:
        # No log begins like a web page.
        if self._web and head[:512].lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith(_PAGE_STARTS):
            problem = "the answer is a web page, perhaps for login, not a log"
            raise refused(
                file.url, f"{problem}; expected the address of the file itself, signed if necessary"
            )

    def _key(self, url: str) -> str:
        """Return the name of an object for fsspec; a web address is its own name."""
        if not self._web:
            return url.partition("://")[2].rstrip("/")
        parts = split_web(url)
        path, query = (quote(part, safe=_SAFE) for part in (parts.path, parts.query))
        return urlunsplit((parts.scheme, parts.netloc, path, query, ""))

    def _url(self, key: str) -> str:
        return f"{self._scheme}://{key}"

    def _asked(self, url: str, work: Callable[[], Result]) -> Result:
        """Return the result of a request, with further attempts after a temporary failure."""
        waits = [*WAITS] if self._scheme in _RETRIED_HERE else []
        attempts = len(waits) + 1
        while True:
            try:
                return work()
            except (ReadError, SettingError, _WholeOnlyError):
                raise
            except Exception as error:
                refusal = explained(error, url, timeout_s=timeout())
                if not isinstance(refusal, PassingError):
                    raise refusal from error
                if not waits:
                    often = f" ({attempts} attempts)" if attempts > 1 else ""
                    raise refused(url, f"{refusal.problem}{often}", "try again later") from error
                time.sleep(waits.pop(0))


def empty(url: str) -> ReadError:
    """Return the error for a file without bytes."""
    return refused(url, "the file is empty; expected a log")


def changed(url: str) -> ReadError:
    """Return the error for a file that is not the one that was identified."""
    advice = "wait until it is complete, and run the command again"
    return refused(url, "it changed during the download", advice)


def _entity_tag(info: dict[str, Any]) -> str:
    """Return the ETag in quotes, which Google and Azure sometimes omit, or the time of the last change."""
    tag = str(info.get("ETag") or info.get("etag") or "")
    if tag:
        return tag if tag.startswith(('"', "W/")) else f'"{tag}"'
    names = ("LastModified", "Last-Modified", "last_modified", "updated", "mtime")
    return next((str(info[name]) for name in names if info.get(name)), "")


def _file_system(scheme: str) -> Any:  # noqa: ANN401 - fsspec has no types
    """Return a file system without a cache of listings, because objects change."""
    import fsspec.asyn

    for name in ("fsspec", "s3fs", "gcsfs", "adlfs", "botocore", "aiobotocore", "google", "azure"):
        logging.getLogger(name).addHandler(logging.NullHandler())
    _name_threads(fsspec.asyn.get_loop())
    settings: dict[str, Any] = {"use_listings_cache": False}
    if scheme in WEB:
        settings |= _web_settings()
    elif PACKAGES[scheme] == "s3fs":
        config = {"connect_timeout": timeout(), "read_timeout": timeout(), "retries": {"max_attempts": 1}}
        settings["config_kwargs"] = config | fsspec.config.conf.get("s3", {}).get("config_kwargs", {})
    return fsspec.filesystem(scheme, **settings)


@functools.cache
def _name_threads(loop: "AbstractEventLoop") -> None:
    """Give the threads that look up hosts a name by which `may_fork` recognises them as idle."""
    loop.set_default_executor(ThreadPoolExecutor(thread_name_prefix=DOWNLOADS))


def _web_settings() -> dict[str, Any]:
    import aiohttp

    waits = aiohttp.ClientTimeout(total=None, sock_connect=timeout(), sock_read=timeout())
    # Proxies come from the environment, passwords from ~/.netrc. A compressed file stays compressed.
    client = {"trust_env": True, "auto_decompress": False, "timeout": waits}
    headers = {"User-Agent": f"imucal/{__version__}", "Accept-Encoding": "identity"}
    return {"client_kwargs": client, "headers": headers, "encoded": True, "simple_links": False}


_METADATA = "metadata.yaml"
#: A compressed text may have one more extension.
_MESSAGES = (".mcap", ".bag", ".db3", ".bag.active", ".mcap.zstd", ".mcap.zst", ".db3.zstd", ".db3.zst")
_TEXTS = (".csv", ".tsv", ".txt", ".log", ".dat", ".jsonl")
_TABLES = (*_TEXTS, ".parquet", ".h5", ".hdf5", ".npz", ".npy", ".mat", ".ulg", ".bin")
_PACKED = ("", ".gz", ".bz2", ".xz", ".zst", ".zstd", ".zip")
_LOGS = (*_MESSAGES, *(table + packed for table in _TABLES for packed in _PACKED))


def expand(url: str) -> list[str]:
    """Return the URLs of the logs of a URL: itself, the matches of its wildcards, or a folder's logs.

    A folder with ``metadata.yaml``, or with only tables, is one log. Raises ReadError.
    """
    store = Store(url)
    if has_wildcards(url):
        return _matches(store, url)
    if name_of(url).endswith(_LOGS) and not is_folder_name(url):
        return [url]
    if store.look_at(url) is not None:
        return [url]
    logs = _logs_in(store, url)
    names = [name_of(log) for log in logs]
    if _METADATA in names or not any(name.endswith(_MESSAGES) for name in names):
        return [url]
    return [log for log in logs if name_of(log).endswith(_MESSAGES)]


def _matches(store: Store, url: str) -> list[str]:
    found = [match for match in store.matches(url) if name_of(match).endswith(_LOGS)]
    if found:
        return found
    with suppress(ReadError):
        # Names may contain wildcard characters.
        if store.look_at(url) is not None:
            return [url]
    raise refused(url, "no log has this name; expected an ending such as .mcap, .bag or .csv")


def identify(url: str, *, keep: bool = True) -> RemoteLog:
    """Return name, ETag and size of a log without reading it; with `keep` its copy stays in the cache.

    Raises ReadError if the log is missing, access is denied or the store does not answer.
    """
    store = Store(url)
    file = store.look_at(url)
    if file is None:
        files = [found for log in _logs_in(store, url) if (found := store.look_at(log))]
        return RemoteLog(url=url, files=tuple(files), folder=True, keep=keep)
    if file.size == 0:
        raise empty(url)
    return RemoteLog(url=url, files=(file,), keep=keep)


def _logs_in(store: Store, url: str) -> list[str]:
    files = store.files_in(url)
    logs = [file for file in files if name_of(file) == _METADATA or name_of(file).endswith(_LOGS)]
    if not any(name_of(log) != _METADATA for log in logs):
        inside = ", ".join(name_of(file) for file in files[:10]) or "nothing"
        raise refused(url, f"a folder with {inside}; expected logs, such as .mcap, .bag or .csv files")
    return logs

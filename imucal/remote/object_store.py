"""Logs in the object stores that fsspec reads: S3, Google Cloud Storage, Azure.

Credentials, endpoints and proxies are found as s3fs, gcsfs and adlfs find them.
"""

import importlib.util
import logging
import shlex
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from imucal.errors import ImucalError, ReadError
from imucal.remote.addresses import OBJECT_STORES, scheme_of, shown
from imucal.remote.failures import ChangedError, PassingError, explained, retried, timeout
from imucal.remote.remote_log import RemoteFile

Result = TypeVar("Result")

#: Bytes of one request of a download.
_PART = 1 << 24


class ObjectStore:
    """The objects of one kind of store."""

    def __init__(self, url: str) -> None:
        self._scheme = scheme_of(url)
        protocol, package, extra = OBJECT_STORES[self._scheme]
        if any(importlib.util.find_spec(name) is None for name in ("fsspec", package)):
            typed = shlex.quote(f"imucal-noise[{extra}]")
            msg = f"{shown(url)}: {self._scheme}:// needs the package {package}; type: pip install {typed}"
            raise ReadError(msg)
        self._url = url
        self._files = self._asked(url, lambda: _file_system(protocol))

    def look_at(self, url: str) -> RemoteFile | None:
        info = self._asked(url, lambda: self._files.info(self._key(url)))
        if info.get("type") == "directory":
            return None
        if info.get("size") is None:
            msg = f"{shown(url)}: its store does not say how large it is; expected an object of known size"
            raise ReadError(msg)
        return RemoteFile(url=url, etag=_tag(info), size=int(info["size"]))

    def read(self, file: RemoteFile, start: int, stop: int) -> bytes:
        return self._asked(file.url, lambda: self._part(file, start, stop))

    def blocks(self, file: RemoteFile, start: int) -> Iterator[bytes]:
        size = file.size or 0
        for at in range(start, size, _PART):
            try:
                yield self._part(file, at, min(at + _PART, size))
            except Exception as error:
                raise _ours(error, file.url) from error
        # Parts may be of two objects where one took the place of the other meanwhile.
        now = self.look_at(file.url)
        if now is None or (now.etag, now.size) != (file.etag, file.size):
            raise ChangedError

    def files_in(self, url: str) -> list[str]:
        listed = self._asked(url, lambda: self._files.ls(self._key(url), detail=True))
        return sorted(self._name(entry["name"]) for entry in listed if entry.get("type") == "file")

    def matches(self, url: str) -> list[str]:
        found = self._asked(url, lambda: self._files.glob(self._key(url)))
        return sorted(map(self._name, found))

    def _part(self, file: RemoteFile, start: int, stop: int) -> bytes:
        data: bytes = self._files.cat_file(self._key(file.url), start=start, end=stop)
        if len(data) > stop - start or (len(data) < stop - start and stop <= (file.size or 0)):
            raise ChangedError
        return data

    def _key(self, url: str) -> str:
        return url.partition("://")[2].rstrip("/")

    def _name(self, key: str) -> str:
        return f"{self._scheme}://{key}"

    def _asked(self, url: str, work: Callable[[], Result]) -> Result:
        """Return what the library answers; its errors become ours."""

        def attempt() -> Result:
            try:
                return work()
            except Exception as error:
                raise _ours(error, url) from error

        return retried(url, attempt)


def _ours(error: Exception, url: str) -> Exception:
    return error if isinstance(error, ImucalError | PassingError | ChangedError) else explained(error, url)


def _tag(info: dict[str, Any]) -> str:
    """Return the ETag in quotes, as S3 writes it; Google and Azure leave them out at times."""
    tag = info.get("ETag") or info.get("etag")
    if tag:
        return str(tag) if str(tag).startswith('"') else f'"{tag}"'
    times = (info.get(name) for name in ("LastModified", "last_modified", "updated", "mtime"))
    return next((str(time) for time in times if time), "")


def _file_system(protocol: str) -> Any:  # noqa: ANN401 - fsspec has no types
    """Return a file system that remembers no listings: objects change."""
    import fsspec

    for name in ("fsspec", "s3fs", "gcsfs", "adlfs", "botocore", "aiobotocore", "google", "azure"):
        # What they have to say of a failure stands in its message.
        logging.getLogger(name).addHandler(logging.NullHandler())
    settings: dict[str, Any] = {"use_listings_cache": False}
    if protocol == "s3":
        # Further attempts are made here, with a message at their end.
        config = {"connect_timeout": timeout(), "read_timeout": timeout(), "retries": {"max_attempts": 1}}
        settings["config_kwargs"] = config | fsspec.config.conf.get("s3", {}).get("config_kwargs", {})
    return fsspec.filesystem(protocol, **settings)

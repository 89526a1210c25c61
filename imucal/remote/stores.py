"""What a store of logs can do, and which store a URL is of."""

from collections.abc import Iterator
from typing import Protocol

from imucal.errors import ReadError
from imucal.remote.addresses import OBJECT_STORES, WEB, scheme_of, shown
from imucal.remote.remote_log import RemoteFile


class Store(Protocol):
    """A place that holds logs; every method raises ReadError with a message for people."""

    def look_at(self, url: str) -> RemoteFile | None:
        """Return what is known of an object; None where it is a folder."""

    def read(self, file: RemoteFile, start: int, stop: int) -> bytes:
        """Return bytes `start` to `stop` of an object; raises ChangedError where it is another by now."""

    def blocks(self, file: RemoteFile, start: int) -> Iterator[bytes]:
        """Yield an object from byte `start` on; raises PassingError, or ChangedError."""

    def files_in(self, url: str) -> list[str]:
        """Return the URLs of what stands in a folder, without its folders."""

    def matches(self, url: str) -> list[str]:
        """Return the URLs that a URL with wildcards stands for."""


def store_of(url: str) -> Store:
    """Return the store of a URL.

    Raises
    ------
    ReadError
        If no store has such a scheme, or its package is not installed.
    """
    scheme = scheme_of(url)
    if scheme in WEB:
        from imucal.remote.http_store import HttpStore

        return HttpStore()
    if scheme not in OBJECT_STORES:
        hint = "; leave file:// out" if scheme == "file" else ""
        msg = (
            f"{shown(url)}: {scheme}:// is not read; expected s3://, gs://, az://, abfs://, https:// or "
            f"http://{hint}"
        )
        raise ReadError(msg)
    from imucal.remote.object_store import ObjectStore

    return ObjectStore(url)

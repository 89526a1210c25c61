"""The identity of a remote log: name, ETag and size of its files."""

import hashlib
from dataclasses import dataclass, field

from imucal.remote.addresses import name_of, shown


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoteFile:
    """One object of a store.

    Attributes
    ----------
    url
        Where it is, as it was given: with the query, which may be a secret.
    etag
        What changes when the object does: its ETag, or the time of its last change; empty where the
        store says neither.
    size
        Bytes; None where the store doesn't say.
    ranges
        Whether parts of it can be read.
    """

    url: str = field(repr=False)
    etag: str
    size: int | None
    ranges: bool = True

    @property
    def key(self) -> str:
        """Digest of what tells it from any other.

        An ETag stands for the content, so the query, which a signature changes every time, is left out.
        A time of last change does not: then the query may choose the content.
        """
        url = shown(self.url) if self.etag.startswith(('"', "W/")) else self.url
        return _digest(f"{url}\n{self.etag}\n{self.size}")


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoteLog:
    """A log behind a URL: one object, or the folder of a bag.

    Attributes
    ----------
    url
        Where it is: a secret where it is signed; `shown` is for people and files.
    files
        Its objects.
    folder
        Whether it is a folder, which may hold one file.
    keep
        Whether the copy stays in the cache after use.
    """

    url: str = field(repr=False)
    files: tuple[RemoteFile, ...]
    folder: bool = False
    keep: bool = True

    @property
    def shown(self) -> str:
        """The URL without user and query."""
        return shown(self.url).rstrip("/")

    @property
    def name(self) -> str:
        """Name of the file or the folder."""
        return name_of(self.shown)

    @property
    def etag(self) -> str:
        """What changes when the log does; empty where the store doesn't say it of every file."""
        tags = [file.etag for file in self.files]
        if not all(tags):
            return ""
        return (
            tags[0]
            if len(tags) == 1
            else hashlib.blake2b("\n".join(tags).encode(), digest_size=16).hexdigest()
        )

    @property
    def size(self) -> int | None:
        """Bytes of all files; None where the store doesn't say."""
        sizes = [file.size for file in self.files]
        return None if None in sizes else sum(size for size in sizes if size is not None)

    @property
    def key(self) -> str:
        """Name of its place in the cache, and of its results in a fleet: 32 hexadecimal digits."""
        if not self.folder:
            return self.files[0].key
        keys = "\n".join([self.shown, *(file.key for file in self.files)])
        return _digest(keys)


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

"""URLs of logs: their parts, their form without secrets, and keys that identify logs."""

import hashlib
import re
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from urllib.parse import SplitResult, unquote, urlsplit, urlunsplit

from imucal.errors import Fix, ReadError

#: At least two letters: C: is a drive.
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
#: A `Path` of a URL lacks a slash.
_COLLAPSED = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/(?!/)")
#: Longest file name on common file systems, in bytes.
_MAX_NAME_BYTES = 200
_GLOB = frozenset("*?[")


#: Scheme of a URL -> package that reads it with fsspec.
PACKAGES = {
    "http": "aiohttp",
    "https": "aiohttp",
    "s3": "s3fs",
    "s3a": "s3fs",
    "gs": "gcsfs",
    "gcs": "gcsfs",
    "az": "adlfs",
    "abfs": "adlfs",
    "abfss": "adlfs",
}
WEB = frozenset({"http", "https"})


def is_url(log: object) -> bool:
    """Return whether a log is a URL; raises ReadError for a URL that was converted to a `Path`."""
    if isinstance(log, Path):
        if (match := _COLLAPSED.match(str(log))) and not log.exists():
            url = str(log).replace(":/", "://", 1)
            raise refused(url, f"a URL that was a Path; expected {match[1]}://… as text")
        return False
    return isinstance(log, str) and _URL.match(log) is not None


def scheme_of(url: str) -> str:
    """Return the scheme in lower case."""
    match = _URL.match(url)
    return match[1].lower() if match else ""


def shown(url: str) -> str:
    """Return a URL without user, password, query and fragment, for messages and results.

    The query of a signed URL is a secret. Object keys may contain question marks and are kept.
    """
    if not _URL.match(url):
        return url
    if scheme_of(url) in WEB:
        parts = split_web(url)
        return urlunsplit((parts.scheme, parts.netloc.rpartition("@")[2], parts.path, "", ""))
    scheme, _, rest = url.partition("://")
    host, slash, path = rest.partition("/")
    user, _, place = host.rpartition("@")
    # Azure writes container@account, which is not a secret.
    return f"{scheme}://{place if ':' in user else host}{slash}{path}"


def split_web(url: str) -> SplitResult:
    """Return the parts of a web address; raises ReadError if it is not one."""
    try:
        return urlsplit(url)
    except ValueError as error:
        # The parts are unknown, so a password can't be removed.
        place = re.sub(r"//[^/]*@", "//", url).partition("?")[0]
        problem = f"not a valid web address ({error}); expected https://host/path"
        raise ReadError(problem, place=place) from error


def refused(url: str, problem: str, advice: str = "") -> ReadError:
    """Return the error for a URL that can't be read."""
    return ReadError(problem, place=shown(url), fix=Fix(advice) if advice else None)


def path_of(url: str) -> str:
    """Return the path of a URL without bucket or host."""
    if scheme_of(url) in WEB:
        return unquote(split_web(url).path)
    return url.partition("://")[2].partition("/")[2]


def name_of(url: str) -> str:
    """Return a file name valid on every file system; ``log`` if the URL has none."""
    name = PurePosixPath(path_of(url)).name
    name = "".join("_" if sign in '\\/:*?"<>|' or not sign.isprintable() else sign for sign in name)
    if not name.strip("."):
        return "log"
    while len(name.encode()) > _MAX_NAME_BYTES:
        name = name[1:]
    return name


def has_wildcards(url: str) -> bool:
    """Return whether a URL has wildcards: ``*``, ``?``, ``[…]``; only ``*`` in a web address."""
    signs = _GLOB if scheme_of(url) not in WEB else {"*"}
    return bool(signs & set(path_of(url)))


def is_folder_name(url: str) -> bool:
    """Return whether a URL has the form of a folder."""
    return path_of(url).endswith("/") or not path_of(url)


def without_secrets(text: str, url: str) -> str:
    """Remove the users and queries of URLs from a message."""
    text = text.replace(url, shown(url))
    text = re.sub(r"(https?://)[^\s/'\"]*@", r"\1", text)
    return re.sub(r"(\w://[^\s?'\"]*)\?[^\s'\")]*", r"\1", text)


@dataclass(frozen=True, kw_only=True)
class RemoteFile:
    """One object of a store."""

    #: With its query, which may be a secret.
    url: str = field(repr=False)
    #: In quotes, or the time of the last change; empty if unknown.
    etag: str
    #: In bytes; None if unknown.
    size: int | None


@dataclass(frozen=True, kw_only=True)
class RemoteLog:
    """A log at a URL: one object, or the folder of a bag."""

    #: A secret if it is signed; print `shown` instead.
    url: str = field(repr=False)
    files: tuple[RemoteFile, ...]
    #: Whether it is a folder, perhaps of one file.
    folder: bool = False
    #: Whether the copy stays in the cache after use.
    keep: bool = True

    @property
    def shown(self) -> str:
        return shown(self.url).rstrip("/")

    @property
    def name(self) -> str:
        return name_of(self.shown)

    @property
    def etag(self) -> str:
        """Of the file, or a digest of all ETags; empty if one is missing."""
        tags = [file.etag for file in self.files]
        if not all(tags):
            return ""
        return tags[0] if len(tags) == 1 else _digest("\n".join(tags))

    @property
    def size(self) -> int | None:
        sizes = [file.size for file in self.files]
        return None if None in sizes else sum(size for size in sizes if size is not None)

    @property
    def key(self) -> str:
        """Name in the cache: a digest of URL, ETag and size, of 32 hexadecimal digits.

        The query, which changes with each signature, counts only without an ETag: it may select the content.
        """
        url = self.shown if self.etag.startswith(('"', "W/")) else self.url
        return _digest(f"{url}\n{self.etag}\n{self.size}")


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

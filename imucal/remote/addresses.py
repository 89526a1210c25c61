"""Addresses of logs: what a URL says, what may be shown of it, and what tells the log behind it from others.

And what goes wrong between here and a store: what may pass is tried again, the rest is a message.
"""

import hashlib
import os
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import field
from pathlib import Path, PurePosixPath
from typing import TypeVar
from urllib.parse import unquote, urlsplit, urlunsplit

from imucal.errors import ImucalError, ReadError, SettingError
from imucal.frozen import frozen

#: A scheme has two letters or more: C: is a drive.
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
#: What is left of a URL that went through a `Path`, which takes one of the slashes away.
_COLLAPSED = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/(?!/)")
WEB = frozenset({"http", "https"})
#: Scheme -> protocol of fsspec, its package, and the extra that brings it.
OBJECT_STORES = {
    "s3": ("s3", "s3fs", "s3"),
    "s3a": ("s3", "s3fs", "s3"),
    "gs": ("gs", "gcsfs", "gcs"),
    "gcs": ("gs", "gcsfs", "gcs"),
    "az": ("az", "adlfs", "azure"),
    "abfs": ("abfs", "adlfs", "azure"),
    "abfss": ("abfs", "adlfs", "azure"),
}
#: Bytes that a file's name may have on every file system that is common.
_LONGEST = 200
_GLOB = frozenset("*?[")


def is_url(log: object) -> bool:
    """Return whether a text is a URL and not the path of a file.

    Raises ReadError if it is a URL that was made a `Path`.
    """
    if isinstance(log, Path):
        if (match := _COLLAPSED.match(str(log))) and not log.exists():
            url = str(log).replace(":/", "://", 1)
            raise refused(url, f"a URL that was a Path; expected {match[1]}://… as text")
        return False
    return isinstance(log, str) and _URL.match(log) is not None


def scheme_of(url: str) -> str:
    """Return such as ``s3``, in small letters."""
    match = _URL.match(url)
    return match[1].lower() if match else ""


def shown(url: str) -> str:
    """Return what may be printed and stored of a URL: no user, no password, no query, no fragment.

    The query of a signed URL is as good as a password. Keys of an object store may hold question marks,
    so there it stays. A path of this machine is returned as it is.
    """
    if not _URL.match(url):
        return url
    if scheme_of(url) in WEB:
        parts = urlsplit(url)
        return urlunsplit((parts.scheme, parts.netloc.rpartition("@")[2], parts.path, "", ""))
    scheme, _, rest = url.partition("://")
    host, slash, path = rest.partition("/")
    user, _, place = host.rpartition("@")
    # Azure writes container@account, which is no secret.
    return f"{scheme}://{place if ':' in user else host}{slash}{path}"


def refused(url: str, text: str) -> ReadError:
    """Return the error of a URL that is not read; the text says what was found, and what to do."""
    return ReadError(f"{shown(url)}: {text}")


def path_of(url: str) -> str:
    """Return the path of a URL as people write it, without the bucket or the host."""
    if scheme_of(url) in WEB:
        return unquote(urlsplit(url).path)
    return url.partition("://")[2].partition("/")[2]


def name_of(url: str) -> str:
    """Return the name of the file, fit for every file system; ``log`` where the URL has none."""
    name = PurePosixPath(path_of(url)).name
    name = "".join("_" if sign in '\\/:*?"<>|' or not sign.isprintable() else sign for sign in name)
    if not name.strip("."):
        return "log"
    while len(name.encode()) > _LONGEST:
        name = name[1:]
    return name


def has_wildcards(url: str) -> bool:
    """Return whether a URL stands for several: ``*``, ``?`` and ``[…]``; in a web address ``*`` alone."""
    signs = _GLOB if scheme_of(url) not in WEB else {"*"}
    return bool(signs & set(path_of(url)))


def is_folder_name(url: str) -> bool:
    """Return whether a URL says that it is a folder."""
    return path_of(url).endswith("/") or not path_of(url)


def without_secrets(text: str, url: str) -> str:
    """Return what a library said, without the query of a URL."""
    text = text.replace(url, shown(url))
    return re.sub(r"(\w://[^\s?'\"]*)\?[^\s'\")]*", r"\1", text)


@frozen
class RemoteFile:
    """One object of a store."""

    #: Where it is, as it was given: with the query, which may be a secret.
    url: str = field(repr=False)
    #: What changes when the object does: its ETag, or the time of its last change; empty where the
    #: store says neither.
    etag: str
    #: Bytes; None where the store doesn't say.
    size: int | None
    #: Whether parts of it can be read.
    ranges: bool = True

    @property
    def key(self) -> str:
        """Digest of what tells it from any other.

        An ETag stands for the content, so the query, which a signature changes every time, is left out.
        A time of last change does not: then the query may choose the content.
        """
        url = shown(self.url) if self.etag.startswith(('"', "W/")) else self.url
        return _digest(f"{url}\n{self.etag}\n{self.size}")


@frozen
class RemoteLog:
    """A log behind a URL: one object, or the folder of a bag."""

    #: Where it is: a secret where it is signed; `shown` is for people and files.
    url: str = field(repr=False)
    #: Its objects.
    files: tuple[RemoteFile, ...]
    #: Whether it is a folder, which may hold one file.
    folder: bool = False
    #: Whether the copy stays in the cache after use.
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
        return tags[0] if len(tags) == 1 else _digest("\n".join(tags))

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
        return _digest("\n".join([self.shown, *(file.key for file in self.files)]))


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


Result = TypeVar("Result")

#: Seconds to wait before each further attempt.
WAITS = (0.5, 1.0, 2.0)
_RETRIED_HERE = WEB | {"s3", "s3a"}
TIMEOUT = "IMUCAL_REMOTE_TIMEOUT"
#: Seconds without an answer before a connection is given up.
_PATIENCE = 30.0

_CREDENTIALS = frozenset({
    "NoCredentialsError", "PartialCredentialsError", "CredentialRetrievalError", "TokenRetrievalError",
    "ProfileNotFound", "DefaultCredentialsError", "RefreshError", "ClientAuthenticationError",
    "CredentialUnavailableError",
})  # fmt: skip
#: Names of the errors of libraries that may be missing here: of a connection, and of waiting for an answer.
_CONNECTION = frozenset({
    "EndpointConnectionError", "ClientConnectionError", "ConnectionError", "ServiceRequestError",
    "ServiceResponseError", "HTTPClientError", "ClientPayloadError", "ResponseStreamingError",
    "IncompleteReadError", "IncompleteRead", "SSLError",
})  # fmt: skip
_LATE = frozenset({"TimeoutError", "ConnectTimeoutError", "ReadTimeoutError", "ServerTimeoutError"})
_MISSING = frozenset({"FileNotFoundError", "ResourceNotFoundError", "NoSuchBucket", "NoSuchKey"})
_NO_BUCKET = re.compile(r"NoSuchBucket|(specified )?(bucket|container) does not exist", re.IGNORECASE)
#: What to do about credentials, by scheme.
_LOG_IN = {
    "s3": "set AWS_PROFILE, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY; "
          "for a public bucket FSSPEC_S3_ANON=true",
    "gs": "run 'gcloud auth application-default login', or set GOOGLE_APPLICATION_CREDENTIALS",
    "az": "set AZURE_STORAGE_ACCOUNT_NAME with AZURE_STORAGE_ACCOUNT_KEY or AZURE_STORAGE_SAS_TOKEN, "
          "or AZURE_STORAGE_CONNECTION_STRING",
}  # fmt: skip


class PassingError(Exception):
    """Something that may pass: worth another attempt."""


class ChangedError(Exception):
    """The object is not the one that was asked for any more."""


def timeout() -> float:
    """Return how many seconds an answer may take: ``IMUCAL_REMOTE_TIMEOUT``, or 30.

    Raises SettingError if it is no positive number.
    """
    text = os.environ.get(TIMEOUT, "").strip()
    if not text:
        return _PATIENCE
    try:
        seconds = float(text.removesuffix("s"))
    except ValueError:
        seconds = 0.0
    if not 0 < seconds < 1e6:
        raise SettingError(f"{TIMEOUT}: found {text!r}, expected seconds such as 60; set some, or unset it")
    return seconds


class Attempts:
    """Counts failures in a row; each is waited for, and the last one is the message."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._failed = 0
        # The libraries of Google and Azure wait and try again themselves, for half a minute.
        self._waits = WAITS if scheme_of(url) in _RETRIED_HERE else ()

    def went_on(self) -> None:
        """Start to count anew: something came."""
        self._failed = 0

    def wait(self, error: PassingError) -> None:
        """Wait before the next attempt; raises ReadError if it was the last one."""
        self._failed += 1
        if self._failed > len(self._waits):
            often = f" ({self._failed} attempts)" if self._waits else ""
            raise refused(self._url, f"{error}{often}; try again later") from error
        time.sleep(self._waits[self._failed - 1])


def retried(url: str, work: Callable[[], Result]) -> Result:
    """Return what `work` does, tried again where that may pass; raises ReadError if it fails every time."""
    attempts = Attempts(url)
    while True:
        try:
            return work()
        except PassingError as error:
            attempts.wait(error)


def missing(url: str, what: str = "object") -> ReadError:
    """Return the error of what is not there."""
    return refused(url, f"there is no such {what} (404); check the address")


def forbidden(url: str, code: int = 403) -> ReadError:
    """Return the error of what may not be read."""
    scheme = scheme_of(url)
    if scheme not in _LOG_IN:
        hint = "perhaps a signed address has expired; create a new one, or put name and password in ~/.netrc"
        return refused(url, f"access is denied ({code}); {hint}")
    return refused(url, f"access is denied ({code}) to these credentials; {_LOG_IN[scheme]}")


def explained(error: Exception, url: str) -> Exception:
    """Return an error as one of ours, which stay: a `PassingError`, or a `ReadError` with a message."""
    if isinstance(error, ImucalError | PassingError | ChangedError):
        return error
    names = {kind.__name__ for cause in _chain(error) for kind in type(cause).__mro__}
    text = without_secrets(" ".join(str(error).split())[:200], url)
    if names & _MISSING:
        return missing(url, "bucket" if _NO_BUCKET.search(f"{names} {text}") else "object")
    if "PermissionError" in names:
        return forbidden(url)
    passing = _passing(names, text)
    if passing:
        return PassingError(passing)
    what = f"can't be read: {text or type(error).__name__}"
    if names & _CREDENTIALS or "Must provide either a connection_string" in text:
        what = f"no credentials, or wrong ones; {_LOG_IN.get(scheme_of(url), 'log in')}"
    elif "SSLCertVerificationError" in names:
        what = f"the server's certificate is not trusted: {text}"
    return refused(url, what)


def _passing(names: set[str], text: str) -> str:
    """Return what may pass; empty where it is something else."""
    if names & (_CREDENTIALS | {"SSLCertVerificationError"}):
        return ""
    if names & {"gaierror", "ClientConnectorDNSError"}:
        return "host not found: no network, or a mistake in its name"
    if names & _LATE:
        return f"no answer within {timeout():g} s"
    return f"the connection failed: {text}" if names & _CONNECTION else ""


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and what led to it."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        reason = getattr(error, "reason", None)
        error = reason if isinstance(reason, BaseException) else error.__cause__ or error.__context__

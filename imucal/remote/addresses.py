"""URLs of logs: their parts, their form without secrets, and keys that identify logs; errors of stores."""

import hashlib
import os
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import field
from pathlib import Path, PurePosixPath
from typing import TypeVar
from urllib.parse import SplitResult, unquote, urlsplit, urlunsplit

from imucal.errors import ArgumentError, ImucalError, ReadError, SettingError
from imucal.frozen import frozen
from imucal.user_input import seconds_of

#: At least two letters: C: is a drive.
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
#: A `Path` of a URL lacks a slash.
_COLLAPSED = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/(?!/)")
WEB = frozenset({"http", "https"})
OBJECT_STORES = {
    "s3": ("s3", "s3fs", "s3"),
    "s3a": ("s3", "s3fs", "s3"),
    "gs": ("gs", "gcsfs", "gcs"),
    "gcs": ("gs", "gcsfs", "gcs"),
    "az": ("az", "adlfs", "azure"),
    "abfs": ("abfs", "adlfs", "azure"),
    "abfss": ("abfs", "adlfs", "azure"),
}
#: Longest file name on common file systems, in bytes.
_MAX_NAME_BYTES = 200
_GLOB = frozenset("*?[")


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
        text = f"not a valid web address ({error}); expected https://host/path"
        raise ReadError(text, place=place) from error


def refused(url: str, text: str) -> ReadError:
    """Return the error for a URL that can't be read."""
    return ReadError(text, place=shown(url))


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
    """Remove the queries of URLs from a message."""
    text = text.replace(url, shown(url))
    return re.sub(r"(\w://[^\s?'\"]*)\?[^\s'\")]*", r"\1", text)


@frozen
class RemoteFile:
    """One object of a store."""

    #: With its query, which may be a secret.
    url: str = field(repr=False)
    #: Or the time of the last change; empty if unknown.
    etag: str
    #: In bytes; None if unknown.
    size: int | None
    #: Whether the store serves parts of the object.
    ranges: bool = True

    @property
    def key(self) -> str:
        """Digest of URL, ETag and size.

        The query, which changes with each signature, counts only without an ETag: it may select the content.
        """
        url = shown(self.url) if self.etag.startswith(('"', "W/")) else self.url
        return _digest(f"{url}\n{self.etag}\n{self.size}")


@frozen
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
        """Key in the cache and in a fleet's results: 32 hexadecimal digits."""
        if not self.folder:
            return self.files[0].key
        return _digest("\n".join([self.shown, *(file.key for file in self.files)]))


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


Result = TypeVar("Result")

#: Seconds before each further attempt.
WAITS = (0.5, 1.0, 2.0)
_RETRIED_HERE = WEB | {"s3", "s3a"}
TIMEOUT = "IMUCAL_REMOTE_TIMEOUT"
#: Default timeout in s.
_DEFAULT_TIMEOUT_S = 30.0

#: Names, because the libraries may not be installed; the first match is used.
_ERRORS = {
    "missing": "FileNotFoundError ResourceNotFoundError NoSuchBucket NoSuchKey",
    "forbidden": "PermissionError",
    "login": "NoCredentialsError PartialCredentialsError CredentialRetrievalError TokenRetrievalError "
    "ProfileNotFound DefaultCredentialsError RefreshError ClientAuthenticationError "
    "CredentialUnavailableError",
    "certificate": "SSLCertVerificationError",
    "host": "gaierror ClientConnectorDNSError",
    "late": "TimeoutError ConnectTimeoutError ReadTimeoutError ServerTimeoutError",
    "connection": "EndpointConnectionError ClientConnectionError ConnectionError ServiceRequestError "
    "ServiceResponseError HTTPClientError ClientPayloadError ResponseStreamingError IncompleteReadError "
    "IncompleteRead SSLError",
}
_NO_BUCKET = re.compile(r"NoSuchBucket|(specified )?(bucket|container) does not exist", re.IGNORECASE)
_LOG_IN = {
    "s3": "set AWS_PROFILE, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY; "
          "for a public bucket FSSPEC_S3_ANON=true",
    "gs": "run 'gcloud auth application-default login', or set GOOGLE_APPLICATION_CREDENTIALS",
    "az": "set AZURE_STORAGE_ACCOUNT_NAME with AZURE_STORAGE_ACCOUNT_KEY or AZURE_STORAGE_SAS_TOKEN, "
          "or AZURE_STORAGE_CONNECTION_STRING",
}  # fmt: skip


class PassingError(Exception):
    """A temporary failure; another attempt may succeed."""


class ChangedError(Exception):
    """The object has changed since it was identified."""


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


class Attempts:
    """Waits after each failure, and raises an error after the last."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._failed = 0
        # Google's and Azure's libraries retry.
        self._waits = WAITS if scheme_of(url) in _RETRIED_HERE else ()

    def reset(self) -> None:
        self._failed = 0

    def wait(self, error: PassingError) -> None:
        """Raise ReadError after the last attempt."""
        self._failed += 1
        if self._failed > len(self._waits):
            often = f" ({self._failed} attempts)" if self._waits else ""
            raise refused(self._url, f"{error}{often}; try again later") from error
        time.sleep(self._waits[self._failed - 1])


def retried(url: str, work: Callable[[], Result]) -> Result:
    """Return the result of `work`, retried after PassingError; raises ReadError after the last attempt."""
    attempts = Attempts(url)
    while True:
        try:
            return work()
        except PassingError as error:
            attempts.wait(error)


def missing(url: str, what: str = "object") -> ReadError:
    """Return the error for a missing object."""
    return refused(url, f"there is no such {what} (404); check the address")


def forbidden(url: str, code: int = 403) -> ReadError:
    """Return the error for denied access."""
    scheme = scheme_of(url)
    if scheme not in _LOG_IN:
        hint = "perhaps a signed address has expired; create a new one, or put name and password in ~/.netrc"
        return refused(url, f"access is denied ({code}); {hint}")
    return refused(url, f"access is denied ({code}) to these credentials; {_LOG_IN[scheme]}")


def explained(error: Exception, url: str) -> Exception:
    """Convert a library's error to `PassingError` or `ReadError`; return errors of imucal unchanged."""
    if isinstance(error, ImucalError | PassingError | ChangedError):
        return error
    names = {kind.__name__ for cause in _chain(error) for kind in type(cause).__mro__}
    text = without_secrets(" ".join(str(error).split())[:200], url)
    kind = next((kind for kind, known in _ERRORS.items() if names.intersection(known.split())), "")
    if kind == "missing":
        return missing(url, "bucket" if _NO_BUCKET.search(f"{names} {text}") else "object")
    if kind == "forbidden":
        return forbidden(url)
    passing = {
        "host": "host not found: no network, or a mistake in its name",
        "late": f"no answer within {timeout():g} s",
        "connection": f"the connection failed: {text}",
    }
    if kind in passing:
        return PassingError(passing[kind])
    if kind == "login" or "Must provide either a connection_string" in text:
        return refused(url, f"no credentials, or wrong ones; {_LOG_IN.get(scheme_of(url), 'log in')}")
    untrusted = "the server's certificate is not trusted" if kind == "certificate" else "can't be read"
    return refused(url, f"{untrusted}: {text or type(error).__name__}")


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        reason = getattr(error, "reason", None)
        error = reason if isinstance(reason, BaseException) else error.__cause__ or error.__context__

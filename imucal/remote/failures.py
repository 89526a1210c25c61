"""What goes wrong between here and a store: what may pass is tried again, the rest is a message."""

import os
import re
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

from imucal.errors import ReadError, SettingError
from imucal.remote.addresses import WEB, scheme_of, shown, without_secrets

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

    Raises
    ------
    SettingError
        If it is no positive number.
    """
    text = os.environ.get(TIMEOUT, "").strip()
    if not text:
        return _PATIENCE
    try:
        seconds = float(text.removesuffix("s"))
    except ValueError:
        seconds = 0.0
    if not 0 < seconds < 1e6:
        msg = f"{TIMEOUT}: found {text!r}, expected seconds such as 60; set some, or unset it"
        raise SettingError(msg)
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
        """Wait before the next attempt.

        Raises
        ------
        ReadError
            If it was the last one.
        """
        self._failed += 1
        if self._failed > len(self._waits):
            often = f" ({self._failed} attempts)" if self._waits else ""
            msg = f"{shown(self._url)}: {error}{often}; try again later"
            raise ReadError(msg) from error
        time.sleep(self._waits[self._failed - 1])


def retried(url: str, work: Callable[[], Result]) -> Result:
    """Return what `work` does, which is tried again where it fails by something that may pass.

    Raises
    ------
    ReadError
        If it fails every time.
    """
    attempts = Attempts(url)
    while True:
        try:
            return work()
        except PassingError as error:
            attempts.wait(error)


def missing(url: str, what: str = "object") -> ReadError:
    """Return the error of what is not there."""
    return ReadError(f"{shown(url)}: there is no such {what} (404); look at the address")


def forbidden(url: str, code: int = 403) -> ReadError:
    """Return the error of what may not be read."""
    scheme = scheme_of(url)
    if scheme not in _LOG_IN:
        hint = "a signed address may have run out; make a new one, or give name and password in ~/.netrc"
        return ReadError(f"{shown(url)}: access is denied ({code}); {hint}")
    return ReadError(f"{shown(url)}: access is denied ({code}) to these credentials; {_LOG_IN[scheme]}")


def explained(error: Exception, url: str) -> Exception:
    """Return a library's error as one of ours: a `PassingError`, or a `ReadError` with a message."""
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
        what = f"no credentials were found, or they are wrong; {_LOG_IN.get(scheme_of(url), 'log in')}"
    elif "SSLCertVerificationError" in names:
        what = f"the server's certificate is not trusted: {text}"
    return ReadError(f"{shown(url)}: {what}")


def _passing(names: set[str], text: str) -> str:
    """Return what may pass; empty where it is something else."""
    if names & (_CREDENTIALS | {"SSLCertVerificationError"}):
        return ""
    if names & {"gaierror", "ClientConnectorDNSError"}:
        return "the host is not found: no network, or a slip in its name"
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

"""What goes wrong between here and a store: what may pass is tried again, the rest is a message."""

import os
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

from imucal.errors import ReadError, SettingError
from imucal.remote.addresses import scheme_of, shown, without_secrets

Result = TypeVar("Result")

#: Seconds to wait before each further attempt.
WAITS = (0.5, 1.0, 2.0)
TIMEOUT = "IMUCAL_REMOTE_TIMEOUT"
#: Seconds without an answer before a connection is given up.
_PATIENCE = 30.0

_CREDENTIALS = frozenset({
    "NoCredentialsError", "PartialCredentialsError", "CredentialRetrievalError", "TokenRetrievalError",
    "ProfileNotFound", "DefaultCredentialsError", "RefreshError", "ClientAuthenticationError",
    "CredentialUnavailableError",
})  # fmt: skip
#: Names of the errors of libraries that may be missing here: of a connection, and of waiting for an answer.
_CONNECTION = frozenset({"EndpointConnectionError", "ClientConnectionError", "ConnectionError", "ServiceRequestError",
                         "ServiceResponseError", "HTTPClientError", "ClientPayloadError", "ResponseStreamingError",
                         "IncompleteReadError", "IncompleteRead"})  # fmt: skip
_LATE = frozenset({"TimeoutError", "ConnectTimeoutError", "ReadTimeoutError", "ServerTimeoutError"})
_MISSING = frozenset({"FileNotFoundError", "ResourceNotFoundError", "NoSuchBucket", "NoSuchKey"})
#: What to do about credentials, by scheme.
_LOG_IN = {
    "s3": "set AWS_PROFILE, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY; for a public bucket FSSPEC_S3_ANON=true",
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
        if self._failed > len(WAITS):
            msg = f"{shown(self._url)}: {error} ({self._failed} attempts); try again later"
            raise ReadError(msg) from error
        time.sleep(WAITS[self._failed - 1])


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
    # What asked the store has loaded these already.
    import socket
    import ssl

    causes = list(_chain(error))
    names = {kind.__name__ for cause in causes for kind in type(cause).__mro__}
    text = without_secrets(" ".join(str(error).split())[:200], url)
    if names & _CREDENTIALS:
        hint = _LOG_IN.get(scheme_of(url), "log in")
        return ReadError(f"{shown(url)}: no credentials were found, or they are not right; {hint}")
    if names & _MISSING:
        return missing(url, "bucket" if "bucket" in text.lower() or "container" in text.lower() else "object")
    if "PermissionError" in names:
        return forbidden(url)
    if any(isinstance(cause, ssl.SSLCertVerificationError) for cause in causes):
        return ReadError(f"{shown(url)}: the server's certificate is not trusted: {text}")
    if any(isinstance(cause, socket.gaierror) for cause in causes) or "ClientConnectorDNSError" in names:
        return PassingError("the host is not found: no network, or a slip in its name")
    if names & _LATE:
        return PassingError(f"no answer within {timeout():g} s")
    if names & _CONNECTION or any(isinstance(cause, ssl.SSLError) for cause in causes):
        return PassingError(f"the connection failed: {text}")
    return ReadError(f"{shown(url)}: can't be read: {text or type(error).__name__}")


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and what led to it."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        reason = getattr(error, "reason", None)
        error = reason if isinstance(reason, BaseException) else error.__cause__ or error.__context__

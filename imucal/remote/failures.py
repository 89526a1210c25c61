"""The errors of fsspec and its libraries, explained to users."""

import re
from collections.abc import Iterator, Sequence
from http.client import responses

from imucal.errors import ReadError
from imucal.remote.addresses import PACKAGES, WEB, refused, scheme_of, shown, without_secrets

#: HTTP codes of temporary failures.
_PASSING = frozenset({408, 425, 429, 500, 502, 503, 504})
#: HTTP codes of logs that do not exist.
_MISSING = frozenset({404, 410})
#: HTTP codes of missing or wrong credentials.
_DENIED = frozenset({401, 403, 407})
#: Kind of an error -> its HTTP code, which only web servers report.
_CODES = {"missing": 404, "denied": 403}
#: Kind -> names of errors, because the libraries may not be installed; the first match is used.
_ERRORS = {
    "missing": "FileNotFoundError ResourceNotFoundError NoSuchBucket NoSuchKey",
    "denied": "PermissionError",
    "login": "NoCredentialsError PartialCredentialsError CredentialRetrievalError TokenRetrievalError "
    "ProfileNotFound DefaultCredentialsError RefreshError ClientAuthenticationError "
    "CredentialUnavailableError",
    "redirect": "TooManyRedirects RedirectClientError",
    "certificate": "SSLCertVerificationError",
    "host": "gaierror ClientConnectorDNSError",
    "late": "TimeoutError ConnectTimeoutError ReadTimeoutError ServerTimeoutError",
    "ended": "ClientPayloadError ServerDisconnectedError ResponseStreamingError IncompleteReadError",
    "connection": "EndpointConnectionError ClientConnectionError ConnectionError ServiceRequestError "
    "ServiceResponseError HTTPClientError",
}
_NO_BUCKET = re.compile(r"NoSuchBucket|(specified )?(bucket|container) does not exist", re.IGNORECASE)
#: Package -> how to log in.
_LOG_IN = {
    "aiohttp": "perhaps a signed address has expired; create a new one, or put name and password in ~/.netrc",
    "s3fs": "set AWS_PROFILE, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY; "
    "for a public bucket FSSPEC_S3_ANON=true",
    "gcsfs": "run 'gcloud auth application-default login', or set GOOGLE_APPLICATION_CREDENTIALS",
    "adlfs": "set AZURE_STORAGE_ACCOUNT_NAME with AZURE_STORAGE_ACCOUNT_KEY or AZURE_STORAGE_SAS_TOKEN, "
    "or AZURE_STORAGE_CONNECTION_STRING",
}


class PassingError(ReadError):
    """A temporary failure; another attempt may succeed."""


def explained(error: Exception, url: str, *, timeout_s: float) -> ReadError:
    """Return the error for users; a `PassingError` if another attempt may succeed."""
    chain = [*_chain(error, web=scheme_of(url) in WEB)]
    names = {kind.__name__ for cause in chain for kind in type(cause).__mro__}
    # A part of a password must not remain, so the text is cut afterwards.
    text = without_secrets(" ".join(str(chain[0]).split()), url)[:200] or type(chain[0]).__name__
    kind, code = _kind_of(names, text), _code_of(chain)
    if kind == "redirect":
        problem = "the server redirects without end, or to an address outside the web"
        return refused(url, problem, "use the address of the file itself")
    if code or kind in _CODES:
        what = "bucket" if _NO_BUCKET.search(f"{names} {text}") else "object"
        return _answered(url, code or _CODES[kind], what)
    if kind == "login":
        return refused(url, "no credentials, or wrong ones", _LOG_IN[PACKAGES[scheme_of(url)]])
    if kind == "certificate":
        return refused(url, f"the server's certificate is not trusted: {text}")
    passing = {
        "host": "host not found: no network, or a mistake in its name",
        "late": f"no answer within {timeout_s:g} s",
        "ended": "the connection ended early",
        "connection": f"the connection failed: {text}",
    }
    if kind in passing:
        return PassingError(passing[kind], place=shown(url))
    return refused(url, f"can't be read: {text}")


def _kind_of(names: set[str], text: str) -> str:
    """Return the kind of an error from the names of its classes; empty if it is unknown."""
    if "Must provide either a connection_string" in text:
        # Azure's library raises a ValueError without credentials.
        return "login"
    return next((kind for kind, known in _ERRORS.items() if names.intersection(known.split())), "")


def _code_of(chain: Sequence[BaseException]) -> int:
    """Return the code that a web server answered with, or 0.

    Only its errors have a status. The libraries of other stores have an error of their own for each code.
    """
    found = (getattr(cause, "status", None) for cause in chain)
    return next((code for code in found if isinstance(code, int)), 0)


def _answered(url: str, code: int, what: str) -> ReadError:
    """Return the error for an HTTP code."""
    if code in _MISSING:
        return refused(url, f"there is no such {what} ({code})", "check the address")
    if code in _DENIED:
        return refused(url, f"access is denied ({code})", _LOG_IN[PACKAGES[scheme_of(url)]])
    problem = f"the server answers {code} ({responses.get(code, 'unknown code')})"
    if code in _PASSING:
        return PassingError(problem, place=shown(url))
    return refused(url, f"{problem}; expected the file")


def _chain(error: BaseException, *, web: bool) -> Iterator[BaseException]:
    """Yield an error and its causes, without fsspec's FileNotFoundError around the error of a web server."""
    seen: set[int] = set()
    current: BaseException | None = error
    while current is not None and id(current) not in seen:
        seen.add(id(current))
        if not (web and isinstance(current, FileNotFoundError) and current.__cause__):
            yield current
        current = current.__cause__ or current.__context__

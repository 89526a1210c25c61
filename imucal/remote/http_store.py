"""Logs behind http and https, by the standard library: parts, signed addresses, proxies, ~/.netrc.

A look is a GET of the first bytes, not a HEAD: addresses that are signed for GET refuse every other method.
"""

import contextlib
import http.client
import netrc
import re
from base64 import b64encode
from collections.abc import Iterator
from email.message import Message
from fnmatch import fnmatchcase
from html import unescape
from typing import IO
from urllib.error import HTTPError
from urllib.parse import quote, unquote, urljoin, urlsplit, urlunsplit
from urllib.request import Request, urlopen

from imucal._version import __version__
from imucal.errors import ReadError
from imucal.remote.addresses import is_folder_name, shown
from imucal.remote.failures import ChangedError, PassingError, explained, forbidden, missing, retried, timeout
from imucal.remote.remote_log import RemoteFile

#: Codes of servers that are busy or starting.
_PASSING = frozenset({408, 425, 429, 500, 502, 503, 504})
#: Bytes that a look asks for: enough to tell a web page from a log.
_HEAD = 512
_BLOCK = 1 << 20
#: A listing that is larger is none, in bytes.
_PAGE = 1 << 24
_PAGE_STARTS = (b"<!doctype html", b"<html")
_RANGE = re.compile(r"bytes (?:\d+-\d+|\*)/(\d+)")


class HttpStore:
    """Files of web servers."""

    def look_at(self, url: str) -> RemoteFile | None:
        if is_folder_name(url):
            return None
        return retried(url, lambda: self._looked_at(url))

    def _looked_at(self, url: str) -> RemoteFile:
        with _naming(url):
            with _open(url, f"bytes=0-{_HEAD - 1}", empty=True) as (status, headers, body):
                _refuse_page(url, headers, body.read(_HEAD))
            match = _RANGE.match(headers.get("Content-Range", ""))
            length = headers.get("Content-Length", "")
            size = int(match[1]) if match else int(length) if length.isdigit() and status == 200 else None
            return RemoteFile(
                url=url, etag=_tag(headers), size=size, ranges=status != 200 and match is not None
            )

    def read(self, file: RemoteFile, start: int, stop: int) -> bytes:
        def part() -> bytes:
            with _naming(file.url), _open(file.url, f"bytes={start}-{stop - 1}") as (status, headers, body):
                if status != 206 or _tag(headers) != file.etag:
                    raise ChangedError
                data = body.read(stop - start)
                if len(data) != stop - start:
                    msg = "the connection ended early"
                    raise PassingError(msg)
                return data

        return retried(file.url, part)

    def blocks(self, file: RemoteFile, start: int) -> Iterator[bytes]:
        part = f"bytes={start}-" if start else None
        with _naming(file.url), _open(file.url, part) as (status, headers, body):
            if (start and status != 206) or _tag(headers) != file.etag:
                raise ChangedError
            while block := body.read(_BLOCK):
                yield block

    def files_in(self, url: str) -> list[str]:
        folder = url if is_folder_name(url) else f"{shown(url)}/"
        return [link for link in _links(folder) if not link.endswith("/")]

    def matches(self, url: str) -> list[str]:
        parts = urlsplit(url)
        path, _, pattern = parts.path.rpartition("/")
        if "*" in path:
            msg = f"{shown(url)}: a web address may have * in its last part only, such as …/logs/*.mcap"
            raise ReadError(msg)
        folder = urlunsplit((parts.scheme, parts.netloc, f"{path}/", parts.query, ""))
        names = {link: unquote(urlsplit(link).path.rpartition("/")[2]) for link in _links(folder)}
        return [link for link, name in names.items() if fnmatchcase(name, unquote(pattern))]


@contextlib.contextmanager
def _naming(url: str) -> Iterator[None]:
    """Turn what the library raises into errors of ours."""
    try:
        yield
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise explained(error, url) from error


@contextlib.contextmanager
def _open(
    url: str, part: str | None = None, *, empty: bool = False
) -> Iterator[tuple[int, Message, IO[bytes]]]:
    """Yield status, headers and body of an answer; with `empty`, a file without bytes is one."""
    try:
        response = urlopen(_request(url, part), timeout=timeout())  # noqa: S310 - `store_of` looked at the scheme
    except HTTPError as error:
        with error:
            if error.code == 416 and empty:
                yield error.code, error.headers, error
                return
            raise _refusal(url, error.code) from error
    with response:
        yield response.status, response.headers, response


def _refusal(url: str, code: int) -> Exception:
    if code in _PASSING:
        return PassingError(f"the server answers {code} ({http.client.responses[code]})")
    if code in {404, 410}:
        return missing(url)
    if code in {401, 403, 407}:
        return forbidden(url, code)
    if code == 416:
        return ChangedError()
    what = http.client.responses.get(code, "no such code is known")
    return ReadError(f"{shown(url)}: the server answers {code} ({what}); expected the file")


def _request(url: str, part: str | None) -> Request:
    """Return a request; name and password of the URL or of ~/.netrc go to this host alone."""
    parts = urlsplit(url)
    user, _, host = parts.netloc.rpartition("@")
    # Letters beyond ASCII and spaces, as people type them; what is quoted stays.
    path = quote(parts.path, safe="/%:@!$&'()*+,;=~-._")
    request = Request(urlunsplit((parts.scheme.lower(), host, path, parts.query, "")))  # noqa: S310
    request.add_header("User-Agent", f"imucal/{__version__}")
    request.add_header("Accept-Encoding", "identity")
    if part:
        request.add_header("Range", part)
    login = ":".join(map(unquote, user.split(":", 1))) if user else _from_netrc(parts.hostname or "")
    if login:
        request.add_unredirected_header("Authorization", f"Basic {b64encode(login.encode()).decode()}")
    return request


def _from_netrc(host: str) -> str:
    try:
        found = netrc.netrc().authenticators(host)
    except (OSError, netrc.NetrcParseError, RuntimeError):
        return ""
    return f"{found[0]}:{found[2]}" if found else ""


def _tag(headers: Message) -> str:
    return headers.get("ETag") or headers.get("Last-Modified") or ""


def _refuse_page(url: str, headers: Message, head: bytes) -> None:
    """Raise where the answer is a web page: no log begins so."""
    if head.lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith(_PAGE_STARTS):
        kind = headers.get_content_type()
        msg = (
            f"{shown(url)}: the answer is a web page ({kind}), perhaps to log in, and no log; "
            "expected the address of the file itself, signed where it needs to be"
        )
        raise ReadError(msg)


def _links(folder: str) -> list[str]:
    """Return what the listing of a folder links to in that folder, in the order of the names."""

    def page() -> bytes:
        with _naming(folder), _open(folder) as (_, _, body):
            return body.read(_PAGE)

    text = retried(folder, page).decode("utf-8", "replace")
    base = urlsplit(folder).path
    found = set()
    for link in re.findall(r"""href\s*=\s*["']([^"']+)["']""", text, re.IGNORECASE):
        target = urljoin(folder, unescape(link))
        path = urlsplit(target).path
        inside = path.removeprefix(base)
        if path.startswith(base) and inside and "/" not in inside.rstrip("/"):
            found.add(target)
    return sorted(found)

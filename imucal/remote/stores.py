"""Stores of logs: read objects, and list the logs of a URL.

Web files are identified by a GET of the first bytes, because addresses signed for GET refuse HEAD. Object
stores (S3, Google Cloud Storage, Azure) use fsspec with s3fs, gcsfs and adlfs.
"""

import contextlib
import http.client
import importlib.util
import logging
import netrc
import re
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import suppress
from email.message import Message
from fnmatch import fnmatchcase
from html import unescape
from typing import IO, Any, TypeAlias
from urllib.error import HTTPError
from urllib.parse import SplitResult, quote, unquote, urljoin, urlsplit, urlunsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from imucal._version import __version__
from imucal.errors import ReadError
from imucal.remote.addresses import (
    OBJECT_STORES,
    WEB,
    ChangedError,
    PassingError,
    RemoteFile,
    RemoteLog,
    Result,
    explained,
    forbidden,
    has_wildcards,
    is_folder_name,
    missing,
    name_of,
    refused,
    retried,
    scheme_of,
    shown,
    timeout,
)


def store_of(url: str) -> "Store":
    """Return the store of a URL; raises ReadError."""
    scheme = scheme_of(url)
    if scheme in WEB:
        return HttpStore()
    if scheme not in OBJECT_STORES:
        hint = "; omit file://" if scheme == "file" else ""
        text = f"{scheme}:// is not supported; expected s3://, gs://, az://, abfs://, https:// or http://"
        raise refused(url, text + hint)
    return ObjectStore(url)


#: HTTP codes of temporary failures.
_PASSING = frozenset({408, 425, 429, 500, 502, 503, 504})
#: Bytes fetched to identify an object, enough to recognise a web page.
_HEAD = 512
_BLOCK = 1 << 20
#: Largest listing of a folder, in bytes.
_PAGE = 1 << 24
_PAGE_STARTS = (b"<!doctype html", b"<html")
_RANGE = re.compile(r"bytes (?:\d+-\d+|\*)/(\d+)")


class HttpStore:
    """Files of web servers; methods raise ReadError, as in `ObjectStore`."""

    def look_at(self, url: str) -> RemoteFile | None:
        """Return None for a folder."""
        if is_folder_name(url):
            return None

        def looked_at() -> RemoteFile:
            with _open(url, f"bytes=0-{_HEAD - 1}", empty=True) as (status, headers, body):
                if body.read(_HEAD).lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith(_PAGE_STARTS):
                    # No log begins like a web page.
                    kind = headers.get_content_type()
                    expected = "expected the address of the file itself, signed if necessary"
                    why = f"the answer is a web page ({kind}), perhaps for login, not a log; {expected}"
                    raise refused(url, why)
            match = _RANGE.match(headers.get("Content-Range", ""))
            length = headers.get("Content-Length", "")
            size = int(match[1]) if match else int(length) if length.isdigit() and status == 200 else None
            return RemoteFile(
                url=url, etag=_tag(headers), size=size, ranges=status != 200 and match is not None
            )

        return retried(url, looked_at)

    def read(self, file: RemoteFile, start: int, stop: int) -> bytes:
        """Return bytes of an object; raises ChangedError if it has changed."""

        def part() -> bytes:
            data = b"".join(self.blocks(file, start, stop))
            if len(data) != stop - start:
                raise PassingError("the connection ended early")
            return data

        return retried(file.url, part)

    def blocks(self, file: RemoteFile, start: int, stop: int | None = None) -> Iterator[bytes]:
        """Yield the bytes of an object in blocks; raises PassingError or ChangedError."""
        part = f"bytes={start}-{'' if stop is None else stop - 1}" if start or stop else None
        with _open(file.url, part) as (status, headers, body):
            if (part and status != 206) or _tag(headers) != file.etag:
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
            raise refused(url, "a web address may have * in its last part only, such as …/logs/*.mcap")
        folder = urlunsplit((parts.scheme, parts.netloc, f"{path}/", parts.query, ""))
        names = {link: unquote(urlsplit(link).path.rpartition("/")[2]) for link in _links(folder)}
        return [link for link, name in names.items() if fnmatchcase(name, unquote(pattern))]


class _WebRedirects(HTTPRedirectHandler):
    """Follows redirects only to http and https; `urllib` also allows ftp."""

    def http_error_302(self, req: Request, fp: Any, code: int, msg: str, headers: Any) -> Any:  # noqa: ANN401
        target = scheme_of(urljoin(req.full_url, headers.get("Location", "")))
        if target not in WEB:
            fp.close()
            raise _bad_redirect(
                req.full_url, f"to {target}://" if target else "to an address outside the web"
            )
        return super().http_error_302(req, fp, code, msg, headers)

    http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302


def _bad_redirect(url: str, where: str) -> ReadError:
    return refused(url, f"the server redirects {where}; expected a file behind https:// or http://")


@contextlib.contextmanager
def _open(
    url: str, part: str | None = None, *, empty: bool = False
) -> Iterator[tuple[int, Message, IO[bytes]]]:
    """Yield status, headers and body; `empty` allows a file without bytes."""
    try:
        with build_opener(_WebRedirects).open(_request(url, part), timeout=timeout()) as response:
            yield response.status, response.headers, response
    except HTTPError as error:
        with error:
            if error.code == 416 and empty:
                yield error.code, error.headers, error
                return
            raise _refusal(url, error.code) from error
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise explained(error, url) from error


def _refusal(url: str, code: int) -> Exception:
    if code in _PASSING:
        return PassingError(f"the server answers {code} ({http.client.responses[code]})")
    if code in {404, 410}:
        return missing(url)
    if code in {401, 403, 407}:
        return forbidden(url, code)
    if code == 416:
        return ChangedError()
    if code in {301, 302, 303, 307, 308}:
        return _bad_redirect(url, "without end")
    what = http.client.responses.get(code, "unknown code")
    return refused(url, f"the server answers {code} ({what}); expected the file")


def _request(url: str, part: str | None) -> Request:
    """Return a request; credentials from the URL or ~/.netrc are sent only to this host."""
    parts = urlsplit(url)
    user, _, host = parts.netloc.rpartition("@")
    # Keep quoted characters.
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


def _links(folder: str) -> list[str]:
    """Return the links in a folder's listing that point into it on the same server, sorted by name.

    A listing must not make imucal ask other servers, which would get this user's passwords for them.
    """

    def page() -> bytes:
        with _open(folder) as (_, _, body):
            return body.read(_PAGE)

    text = retried(folder, page).decode("utf-8", "replace")
    listed = urlsplit(folder)
    found = set()
    for link in re.findall(r"""href\s*=\s*["']([^"']+)["']""", text, re.IGNORECASE):
        try:
            target = urlsplit(urljoin(folder, unescape(link)))
            same_server = _server(target) == _server(listed)
        except ValueError:
            # The address of the link is invalid.
            continue
        inside = target.path.removeprefix(listed.path)
        in_folder = target.path.startswith(listed.path) and inside and "/" not in inside.rstrip("/")
        if same_server and in_folder:
            # The name and password of the folder, never those in a link.
            found.add(urlunsplit(target._replace(netloc=listed.netloc)))
    return sorted(found)


def _server(parts: SplitResult) -> tuple[str, str | None, int | None]:
    """Return scheme, host and port; raises ValueError for an invalid port."""
    ports = {"http": 80, "https": 443}
    return parts.scheme, parts.hostname, parts.port or ports.get(parts.scheme)


#: Bytes per request of a download.
_PART = 1 << 24


class ObjectStore:
    """Objects in one kind of store."""

    def __init__(self, url: str) -> None:
        self._scheme = scheme_of(url)
        protocol, package, extra = OBJECT_STORES[self._scheme]
        if any(importlib.util.find_spec(name) is None for name in ("fsspec", package)):
            typed = shlex.quote(f"imucal-noise[{extra}]")
            raise refused(url, f"{self._scheme}:// needs the package {package}; type: pip install {typed}")
        self._url = url
        self._files = self._asked(url, lambda: _file_system(protocol))

    def look_at(self, url: str) -> RemoteFile | None:
        info = self._asked(url, lambda: self._files.info(self._key(url)))
        if info.get("type") == "directory":
            return None
        if info.get("size") is None:
            raise refused(url, "its store does not report its size; expected an object of known size")
        return RemoteFile(url=url, etag=_entity_tag(info), size=int(info["size"]))

    def read(self, file: RemoteFile, start: int, stop: int) -> bytes:
        return self._asked(file.url, lambda: self._part(file, start, stop))

    def blocks(self, file: RemoteFile, start: int) -> Iterator[bytes]:
        size = file.size or 0
        for at in range(start, size, _PART):
            try:
                yield self._part(file, at, min(at + _PART, size))
            except Exception as error:
                raise explained(error, file.url) from error
        # Parts may belong to two objects.
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
        def attempt() -> Result:
            try:
                return work()
            except Exception as error:
                raise explained(error, url) from error

        return retried(url, attempt)


def _entity_tag(info: dict[str, Any]) -> str:
    """Google and Azure sometimes omit the quotes."""
    tag = info.get("ETag") or info.get("etag")
    if tag:
        return str(tag) if str(tag).startswith('"') else f'"{tag}"'
    times = (info.get(name) for name in ("LastModified", "last_modified", "updated", "mtime"))
    return next((str(time) for time in times if time), "")


def _file_system(protocol: str) -> Any:  # noqa: ANN401 - fsspec has no types
    """Return a file system without a cache of listings, because objects change."""
    import fsspec

    for name in ("fsspec", "s3fs", "gcsfs", "adlfs", "botocore", "aiobotocore", "google", "azure"):
        logging.getLogger(name).addHandler(logging.NullHandler())
    settings: dict[str, Any] = {"use_listings_cache": False}
    if protocol == "s3":
        config = {"connect_timeout": timeout(), "read_timeout": timeout(), "retries": {"max_attempts": 1}}
        settings["config_kwargs"] = config | fsspec.config.conf.get("s3", {}).get("config_kwargs", {})
    return fsspec.filesystem(protocol, **settings)


Store: TypeAlias = HttpStore | ObjectStore

_METADATA = "metadata.yaml"
#: A compressed text may have one more extension.
_MESSAGES = (".mcap", ".bag", ".db3", ".bag.active", ".mcap.zstd", ".mcap.zst", ".db3.zstd", ".db3.zst")
_TEXTS = (".csv", ".tsv", ".txt", ".log", ".dat", ".jsonl")
_TABLES = (*_TEXTS, ".parquet", ".h5", ".hdf5", ".npz", ".npy", ".mat", ".ulg", ".bin")
_PACKED = ("", ".gz", ".bz2", ".xz", ".zst", ".zstd", ".zip")
_LOGS = (*_MESSAGES, *(table + packed for table in _TABLES for packed in _PACKED))


def expand(url: str) -> list[str]:
    """Return the URLs of the logs of a URL: itself, the matches of its wildcards, or a folder's logs.

    A folder with ``metadata.yaml``, or with only tables, is one log. Raises ReadError.
    """
    store = store_of(url)
    return [url] if _object_at(store, url) else _expanded(store, url)


def logs_at(url: str) -> list[RemoteLog]:
    """Return `identify` of each log of a URL; see `expand`."""
    store = store_of(url)
    file = _object_at(store, url)
    return [_of_one(url, file)] if file else [identify(log) for log in _expanded(store, url)]


def _object_at(store: Store, url: str) -> RemoteFile | None:
    return None if has_wildcards(url) or is_folder_name(url) else store.look_at(url)


def _expanded(store: Store, url: str) -> list[str]:
    if has_wildcards(url):
        found = [match for match in store.matches(url) if name_of(match).endswith(_LOGS)]
        if found:
            return found
        with suppress(ReadError):
            # Names may contain wildcard characters.
            if store.look_at(url) is not None:
                return [url]
        raise refused(url, "no log has this name; expected an ending such as .mcap, .bag or .csv")
    logs = _logs_in(store, url)
    names = [name_of(log) for log in logs]
    if _METADATA in names or not any(name.endswith(_MESSAGES) for name in names):
        return [url]
    return [log for log in logs if name_of(log).endswith(_MESSAGES)]


def identify(url: str, *, keep: bool = True) -> RemoteLog:
    """Return name, ETag and size of a log without reading it; with `keep` its copy stays in the cache.

    Raises ReadError if the log is missing, access is denied or the store does not answer.
    """
    store = store_of(url)
    file = None if is_folder_name(url) else store.look_at(url)
    if file is not None:
        return _of_one(url, file, keep=keep)
    found = [store.look_at(log) for log in _logs_in(store, url)]
    return RemoteLog(url=url, files=tuple(file for file in found if file is not None), folder=True, keep=keep)


def _of_one(url: str, file: RemoteFile, *, keep: bool = True) -> RemoteLog:
    if file.size == 0:
        raise refused(url, "the file is empty; expected a log")
    return RemoteLog(url=url, files=(file,), keep=keep)


def _logs_in(store: Store, url: str) -> list[str]:
    files = store.files_in(url)
    logs = [file for file in files if name_of(file) == _METADATA or name_of(file).endswith(_LOGS)]
    if not any(name_of(log) != _METADATA for log in logs):
        inside = ", ".join(name_of(file) for file in files[:10]) or "nothing"
        raise refused(url, f"a folder with {inside}; expected logs, such as .mcap, .bag or .csv files")
    return logs

"""URLs as text: which they are, what may be shown of them, and the name of the file."""

import re
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit, urlunsplit

from imucal.errors import ReadError

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

    Raises
    ------
    ReadError
        If it is a URL that was made a `Path`.
    """
    if isinstance(log, Path):
        if (match := _COLLAPSED.match(str(log))) and not log.exists():
            url = shown(str(log).replace(":/", "://", 1))
            msg = f"{url}: a URL that went through a Path; expected {match[1]}://… as text"
            raise ReadError(msg)
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

"""Logs behind http: requests, cached copies, and errors."""

import contextlib
import gzip
import re
import socket
from pathlib import Path
from typing import Any

import numpy.testing as npt
import pytest

import imucal
from imucal.errors import ReadError
from imucal.readers import describe
from imucal.remote import stores
from imucal.remote.copies import LocalCopy, fetched
from imucal.remote.stores import expand, identify
from tests.cli.run import SAMPLE_LOGS
from tests.raising import raises
from tests.remote.web_server import WebServer

pytestmark = pytest.mark.usefixtures("cache", "no_waits")

TABLE = b"t,gx,gy,gz,ax,ay,az\n" + b"".join(
    f"{i / 100:.2f},{i % 7 * 1e-4},{i % 5 * 1e-4},{i % 3 * 1e-4},0.{i % 11},0.{i % 13},9.8{i % 9}\n".encode()
    for i in range(2000)
)
OPTIONS: dict[str, Any] = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}


def kept(cache: Path) -> list[str]:
    """Return the names of the files in the cache."""
    return sorted(path.name for path in cache.rglob("*") if path.is_file())


def get(url: str) -> contextlib.AbstractContextManager[LocalCopy]:
    """Return a copy of a log."""
    return fetched(identify(url))


@pytest.mark.parametrize("name", ["consumer_mems.mcap", "tactical.bag", "too_short.db3", "with_gaps.csv"])
def test_a_log_behind_a_url_equals_the_local_log(web: WebServer, name: str) -> None:
    """Samples, clocks and findings are equal; the path is the URL without its query."""
    log = SAMPLE_LOGS / name
    url = web.add(f"/logs/{name}", log.read_bytes())
    here, there = imucal.read(log, checksums=True), imucal.read(f"{url}?sig=SECRET", checksums=True)
    for a, b in zip(here.series, there.series, strict=True):
        npt.assert_array_equal(a.samples, b.samples)
        assert a.clock == b.clock
    assert there.source.path == url
    (file,) = there.source.files
    assert (file.path, file.etag) == (url, '"one"')
    assert (file.size_bytes, file.blake2b) == (here.source.files[0].size_bytes, here.source.files[0].blake2b)
    assert [f.code for f in there.findings] == [f.code for f in here.findings]


def test_a_second_read_downloads_nothing(web: WebServer, cache: Path) -> None:
    """The ETag shows that the copy is valid, and the signature in the query does not matter."""
    url = web.add("/log.csv", TABLE)
    imucal.read(f"{url}?sig=1", **OPTIONS)
    before = web.parts
    imucal.read(f"{url}?sig=2", **OPTIONS)
    assert before == web.parts == [f"bytes=0-{len(TABLE) - 1}"]
    assert kept(cache) == ["log.csv"]


def test_a_changed_object_is_downloaded_again(web: WebServer) -> None:
    """The ETag differs, even if the size is the same."""
    url = web.add("/log.csv", TABLE)
    first = imucal.read(url, **OPTIONS)
    web.add("/log.csv", TABLE.replace(b"0.0001,", b"0.0002,"), etag='"two"')
    second = imucal.read(url, **OPTIONS)
    assert (first.series[0].samples != second.series[0].samples).any()


def test_the_modification_time_replaces_a_missing_etag(web: WebServer, cache: Path) -> None:
    """Without an ETag the query may select the content, so it becomes part of the key."""
    url = web.add("/log.csv", TABLE, etag=None, modified="Sun, 22 Nov 2026 05:00:00 GMT")
    assert identify(url).etag == "Sun, 22 Nov 2026 05:00:00 GMT"
    assert identify(url).key == identify(url).key
    assert identify(f"{url}?id=1").key != identify(f"{url}?id=2").key
    imucal.read(url, **OPTIONS)
    assert kept(cache) == ["log.csv"]


def test_a_log_without_etag_and_modification_time_is_not_cached(web: WebServer, cache: Path) -> None:
    """The validity of a copy could not be checked."""
    url = web.add("/log.csv", TABLE, etag=None)
    assert imucal.read(url, **OPTIONS).series[0].n == 2000
    assert kept(cache) == []


def test_a_broken_download_is_continued(web: WebServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the part that failed is requested again."""
    monkeypatch.setattr(stores, "PART", 60_000)
    url = web.add("/log.csv", TABLE, cuts=[60_000, 20_000])
    with get(url) as copy:
        assert copy.path.read_bytes() == TABLE
    last = f"bytes=60000-{len(TABLE) - 1}"
    assert web.parts == ["bytes=0-59999", last, last]


def test_without_ranges_a_broken_download_restarts(web: WebServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second part shows that the server sends no parts, and the file is requested as a whole."""
    monkeypatch.setattr(stores, "PART", 40_000)
    whole = len(TABLE)
    url = web.add("/log.csv", TABLE, cuts=[whole, whole, whole, 20_000], ranges=False)
    counts: list[int] = []
    with fetched(identify(url), progress=lambda done, _: counts.append(done)) as copy:
        assert copy.path.read_bytes() == TABLE
    assert [bool(part) for _, part, _ in web.asked] == [False, True, True, False, False, False]
    assert counts[-1] == whole


def test_a_server_without_ranges_is_asked_once_for_a_small_log(web: WebServer) -> None:
    url = web.add("/log.csv", TABLE, ranges=False)
    with get(url) as copy:
        assert copy.path.read_bytes() == TABLE
    assert len(web.parts) == 1


@pytest.mark.parametrize("ranges", [True, False])
def test_too_many_broken_connections_are_an_error(web: WebServer, cache: Path, *, ranges: bool) -> None:
    """The limit is four attempts for a part; no incomplete file is left."""
    url = web.add("/log.csv", TABLE, ranges=ranges, cuts=[1000] * 9)
    with raises(ReadError, r"the connection ended early \(4 attempts\); try again later", place=url):
        imucal.read(f"{url}?sig=SECRET")
    assert len(web.parts) == 4
    assert list(cache.iterdir()) == []


def test_an_object_that_changes_during_download_is_refused(web: WebServer, cache: Path) -> None:
    """Parts of the old and the new object must not be joined, or stored as the old one."""
    new = TABLE.replace(b"0.0001,", b"0.0002,")

    class Changing(list[int]):
        def pop(self, index: object = 0) -> int:
            cut = super().pop(0)
            web.add("/log.csv", new, etag='"two"')
            del index
            return cut

    url = web.add("/log.csv", TABLE, cuts=Changing([20_000]))
    message = "it changed during the download; wait until it is complete, and run the command again"
    with raises(ReadError, message, place=url):
        imucal.read(f"{url}?sig=SECRET", **OPTIONS)
    assert kept(cache) == []
    with get(url) as copy:
        assert copy.path.read_bytes() == new
        assert copy.log.etag == '"two"'


@pytest.mark.parametrize("shorter", [1, 30_000])
def test_an_object_that_is_shorter_than_stated_is_refused(web: WebServer, cache: Path, shorter: int) -> None:
    url = web.add("/log.csv", TABLE, head=len(TABLE) + shorter)
    with raises(ReadError, "it changed during the download", place=url):
        imucal.read(url, **OPTIONS)
    assert kept(cache) == []


def test_a_server_may_report_no_length_or_a_wrong_one_of_zero(web: WebServer) -> None:
    """Some servers answer HEAD requests for any file with a length of zero."""
    url = web.add("/log.csv", TABLE, head=0)
    assert imucal.read(url, **OPTIONS).series[0].n == 2000
    url = web.add("/other.csv", TABLE, head=len(TABLE))
    assert imucal.read(url, **OPTIONS).series[0].n == 2000
    assert [path for path, part, _ in web.asked if not part] == ["/log.csv"]


def test_a_compressed_log_is_not_unpacked_by_the_transfer(web: WebServer) -> None:
    """Many servers send a .gz file with a header that says that the transfer is compressed."""
    packed = gzip.compress(TABLE)
    url = web.add("/log.csv.gz", packed, packing="gzip")
    with get(url) as copy:
        assert copy.path.read_bytes() == packed
    assert imucal.read(url, **OPTIONS).series[0].n == 2000


def test_a_failure_of_the_second_log_names_its_url(web: WebServer) -> None:
    """The first log is complete."""
    first, damaged = web.add("/a_1.csv", TABLE), web.add("/a_2.csv", b"Dear diary,\n")
    with raises(ReadError, r"there is no such object \(404\)", place=f"{web.url}/none.csv"):
        imucal.read(f"{first}?sig=SECRET", f"{web.url}/none.csv?sig=SECRET")
    with raises(ReadError, "found no rows of numbers", place=damaged) as error:
        imucal.read(f"{first}?sig=SECRET", f"{damaged}?sig=SECRET", **OPTIONS)
    assert "SECRET" not in str(error.value)


def test_requests_to_busy_servers_are_repeated(web: WebServer) -> None:
    """There are at most three repetitions."""
    url = web.add("/log.csv", TABLE, statuses=[503, 429, 200, 500])
    assert imucal.read(url, **OPTIONS).series[0].n == 2000
    web.add("/log.csv", TABLE, etag='"two"', statuses=[503] * 4)
    message = f"{url}: the server answers 503 (Service Unavailable) (4 attempts); try again later"
    with pytest.raises(ReadError, match=re.escape(message)):
        imucal.read(url)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (404, "there is no such object (404); check the address"),
        (410, "there is no such object (410); check the address"),
        (403, "access is denied (403); perhaps a signed address has expired; create a new one"),
        (401, "access is denied (401); perhaps a signed address"),
        (418, "the server answers 418 (I'm a Teapot); expected the file"),
    ],
)  # fmt: skip
def test_refused_requests_are_not_repeated(web: WebServer, code: int, message: str) -> None:
    """The error does not contain the query."""
    url = web.add("/log.csv", TABLE, statuses=[code])
    with raises(ReadError, re.escape(message), place=url):
        imucal.read(f"{url}?sig=SECRET")
    assert len(web.asked) == 1


def test_a_server_without_an_answer_is_an_error_after_the_timeout(
    web: WebServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The timeout is IMUCAL_REMOTE_TIMEOUT."""
    url = web.add("/log.csv", TABLE, delay_s=0.5)
    monkeypatch.setenv("IMUCAL_REMOTE_TIMEOUT", "0.05")
    with raises(ReadError, r"within 0\.05 s \(4 attempts\)", place="log.csv"):
        imucal.read(url)
    monkeypatch.setenv("IMUCAL_REMOTE_TIMEOUT", "soon")
    with pytest.raises(imucal.ImucalError, match="IMUCAL_REMOTE_TIMEOUT: found 'soon'") as error:
        imucal.read(url)
    assert error.value.exit_code == 2


def test_an_unreachable_server_is_an_error(web: WebServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases: a closed port, and an unknown host."""
    url = web.url
    with raises(ReadError, "the connection failed: ", place="http://127.0.0.1:1/log.csv"):
        imucal.read("http://127.0.0.1:1/log.csv")

    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with raises(ReadError, "host not found: no network", place="http://host/log.csv"):
        imucal.read("http://host/log.csv?sig=SECRET")
    assert url


@pytest.mark.parametrize("start", [b"<!DOCTYPE html><title>Log in</title>", b"\xef\xbb\xbf\r\n <HTML>"])
def test_a_web_page_instead_of_a_log_is_refused(web: WebServer, cache: Path, start: bytes) -> None:
    """A login page has status code 200."""
    url = web.add("/log.mcap", start + b" " * 9000, kind="text/html; charset=utf-8")
    message = "log.mcap: the answer is a web page, perhaps for login, not a log; expected the address"
    with pytest.raises(ReadError, match=re.escape(message)):
        imucal.read(url)
    with pytest.raises(ReadError, match=re.escape(message)):
        describe(url)
    assert kept(cache) == []


def test_an_empty_remote_file_is_refused(web: WebServer) -> None:
    """The error equals that for a local file, although servers refuse a range of an empty file."""
    url = web.add("/log.csv", b"")
    with raises(ReadError, "the file is empty", place="log.csv"):
        imucal.read(url)


def test_a_file_of_unknown_length_is_read(web: WebServer) -> None:
    """The server sends chunks until it closes the connection."""
    url = web.add("/log.csv", TABLE, length=False, ranges=False)
    assert identify(url).size is None
    assert imucal.read(url, **OPTIONS).series[0].n == 2000


def test_redirects_are_followed(web: WebServer) -> None:
    """The log keeps the name of the given address."""
    web.add("/store/0815", TABLE)
    url = web.add("/log.csv", b"", redirect="/store/0815?sig=SECRET")
    assert imucal.read(url, **OPTIONS).source.path == url


@pytest.mark.parametrize(
    "target", ["ftp://127.0.0.1:1/log.csv", "file:///etc/passwd", "data:text/csv,1", "/log.csv"]
)
def test_endless_and_foreign_redirects_are_refused(web: WebServer, target: str) -> None:
    """The error does not contain the secret of the address."""
    url = web.add("/log.csv", b"", redirect=target)
    message = (
        f"{url}: the server redirects without end, or to an address outside the web; "
        "use the address of the file itself"
    )
    with pytest.raises(ReadError, match=f"^{re.escape(message)}$") as error:
        imucal.read(f"{url}?sig=SECRET")
    assert error.value.exit_code == 3


def test_credentials_come_from_the_url_or_netrc(web: WebServer, tmp_path: Path) -> None:
    """Credentials are never shown, and a redirect to another host does not get them."""
    web.add("/log.csv", TABLE, login="Basic bWU6YUBi")
    host = web.url.removeprefix("http://")
    source = imucal.read(f"http://me:a%40b@{host}/log.csv", **OPTIONS, checksums=True).source
    assert source.path == source.files[0].path == f"http://{host}/log.csv"
    with raises(ReadError, r"\(401\)", place="log.csv"):
        imucal.read(f"{web.url}/log.csv")
    (tmp_path / ".netrc").write_text("machine 127.0.0.1 login me password a@b\n", encoding="utf-8")
    (tmp_path / ".netrc").chmod(0o600)
    assert imucal.read(f"{web.url}/log.csv", **OPTIONS).series[0].n == 2000


def test_a_proxy_comes_from_the_environment(web: WebServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """The proxy gets the whole address."""
    web.add("/log.csv", TABLE)
    monkeypatch.setenv("http_proxy", web.url)
    monkeypatch.delenv("no_proxy", raising=False)
    monkeypatch.delenv("NO_PROXY", raising=False)
    assert imucal.read("http://host.invalid/log.csv", **OPTIONS).series[0].n == 2000
    assert {path for path, _, _ in web.asked} == {"http://host.invalid/log.csv"}


def test_a_redirect_to_another_server_gets_no_password(web: WebServer) -> None:
    other = f"http://localhost:{web.url.rpartition(':')[2]}/store.csv"
    web.add("/store.csv", TABLE)
    url = web.add("/log.csv", b"", redirect=other)
    assert imucal.read(url.replace("//", "//me:WORD@"), **OPTIONS).series[0].n == 2000
    assert {(path, bool(login)) for path, _, login in web.asked} == {
        ("/log.csv", True),
        ("/store.csv", False),
    }


def test_urls_can_contain_spaces_and_umlauts(web: WebServer) -> None:
    """Characters may be quoted or not. Impossible file names are replaced."""
    web.add("/Läufe 1/log 1.csv", TABLE)
    for path in ("/Läufe 1/log 1.csv", "/L%C3%A4ufe%201/log%201.csv"):
        with get(web.url + path) as copy:
            assert copy.path.name == "log 1.csv"
    web.add("/..", TABLE)
    web.add("/a:b", TABLE)
    assert [identify(web.url + path).name for path in ("/..", "/a:b")] == ["log", "a_b"]


@pytest.mark.parametrize(
    ("url", "message"),
    [
        (
            "s4://bucket/log.mcap",
            "s4://bucket/log.mcap: s4:// is not supported; expected s3://, gs://, az://",
        ),
        ("file:///logs/log.mcap", "https:// or http://; omit file://"),
        ("ftp://me:word@host/log.csv", "ftp://host/log.csv: ftp:// is not supported"),
        ("http://host:port/log.csv", "http://host:port/log.csv: can't be read: "),
    ],
)
def test_unsupported_schemes_are_refused(url: str, message: str) -> None:
    """The error lists the supported schemes."""
    with pytest.raises(ReadError, match=re.escape(message)):
        imucal.read(url)


def test_a_url_as_a_path_object_is_refused() -> None:
    """A Path removes one of the two slashes."""
    with raises(ReadError, "a URL that was a Path", place="https://host/log.csv"):
        imucal.read(Path("https://host/log.csv?sig=SECRET"))


PAGE = b"""<html><h1>Index of /logs</h1><a href="../">up</a> <a href='a_10.csv'>a</a>
<a href="a_2.csv?sig=1">b</a>
<a href="/logs/notes.md">c</a> <a href="old/">d</a> <a href="http://elsewhere/a_3.csv">e</a></html>"""


def test_wildcards_of_a_web_server_use_its_folder_listing(web: WebServer) -> None:
    web.add("/logs/", PAGE, kind="text/html")
    assert expand(f"{web.url}/logs/a_*.csv") == [f"{web.url}/logs/a_10.csv", f"{web.url}/logs/a_2.csv?sig=1"]
    assert expand(f"{web.url}/logs/") == [f"{web.url}/logs/"]
    with raises(ReadError, "no log has this name", place="logs/b*.csv"):
        expand(f"{web.url}/logs/b*.csv")
    with raises(ReadError, r"\* in its last part only", place="/*/a.csv"):
        expand(f"{web.url}/*/a.csv")
    for folder in ("/logs/?sig=SECRET", "/logs/a_*.csv?sig=SECRET"):
        with raises(ReadError, "with a query; expected", place=folder.partition("?")[0]):
            expand(web.url + folder)
    web.add("/none/", b"<a href='notes.md'>c</a>", kind="text/html")
    with raises(ReadError, r"a folder with notes\.md", place="none/"):
        imucal.read(f"{web.url}/none/")


def test_a_file_of_unknown_length_stops_at_the_size_of_the_cache(
    web: WebServer, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server could send bytes until the disk is full."""
    url = web.add("/log.csv", TABLE, length=False, ranges=False)
    monkeypatch.setenv("IMUCAL_CACHE_SIZE", "10k")
    with raises(ReadError, r"the cache, 1\.02e-05 GB", place="log.csv"):
        imucal.read(url, **OPTIONS)
    assert kept(cache) == []


def test_links_of_a_listing_to_other_servers_are_ignored(web: WebServer) -> None:
    """The user's password for another server would be sent there."""
    port = web.url.rpartition(":")[2]
    links = [
        "a.csv",
        f"{web.url}/dir/b.csv",
        "/dir/c.csv",
        f"http://me:password@127.0.0.1:{port}/dir/k.csv",
        "../dir2/l.csv",
        "sub/m.csv",
        f"http://localhost:{port}/dir/d.csv",
        "//example.com/dir/e.csv",
        f"https://127.0.0.1:{port}/dir/f.csv",
        "http://127.0.0.1:1/dir/g.csv",
        "http://[::1/dir/h.csv",
        "ftp://127.0.0.1/dir/i.csv",
    ]
    web.add("/dir/", "".join(f'<a href="{link}">' for link in links).encode(), kind="text/html")
    for name in "abc":
        web.add(f"/dir/{name}.csv", TABLE)
    assert expand(f"{web.url}/dir/*.csv") == [f"{web.url}/dir/{name}.csv" for name in "abc"]

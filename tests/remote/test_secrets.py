"""Secrets in URLs do not appear on the terminal, in reports or in the cache."""

import json
import re
from pathlib import Path

import jsonschema
import pytest

from imucal.cli.fit import report_folder
from imucal.remote.addresses import has_wildcards, is_url, name_of, shown, without_secrets
from imucal.remote.failures import explained
from imucal.remote.stores import identify
from imucal.report.json_file import load, schema
from tests.cli.run import run
from tests.remote.one_axis import OPTIONS, one_axis
from tests.remote.web_server import WebServer

pytestmark = pytest.mark.usefixtures("cache", "no_waits")

SECRET = "X-Amz-Signature=0815SECRET"  # noqa: S105 - of nothing


def test_the_query_of_a_signed_url_is_not_stored(web: WebServer, tmp_path: Path, cache: Path) -> None:
    """The report contains the URL without the query."""
    url = web.add("/logs/short.csv", one_axis())
    typed = f"{url.replace('//', '//me:WORD@')}?{SECRET}"
    done = run("fit", typed, "--model", "N", "-v", *OPTIONS, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = tmp_path / "short-imucal" / "report.json"
    jsonschema.validate(json.loads(report.read_text(encoding="utf-8")), schema())
    source = load(report).source
    assert source.path == url
    assert [(file.path, file.etag) for file in source.files] == [(url, '"one"')]
    written = [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert len(written) > 4
    names = "".join(str(path) for path in (*tmp_path.rglob("*"), *cache.rglob("*")))
    for secret in ("SECRET", "WORD"):
        assert secret not in done.stdout + done.stderr + names
        assert not any(secret.encode() in text for text in written)
        # The path of the local copy is not stored either.
        assert not any(bytes(cache) in text for text in written if text.startswith(b"{"))


@pytest.mark.parametrize(
    "command", ["fit", "info", "adev", "check --baseline x", "decompose", "export --to ros"]
)
def test_errors_show_no_secret(web: WebServer, tmp_path: Path, command: str) -> None:
    """The exit code is 3, as for a missing local log."""
    done = run(*command.split(), f"{web.url}/none.mcap?{SECRET}", cwd=tmp_path)
    if "--baseline" not in command:
        assert done.returncode == 3
        assert (
            done.stderr == f"Error: {web.url}/none.mcap: there is no such object (404); check the address\n"
        )
    assert "SECRET" not in done.stdout + done.stderr


def test_errors_of_a_reader_contain_the_url(web: WebServer, tmp_path: Path) -> None:
    """The path of the local copy would be meaningless to the user."""
    url = web.add("/notes.txt", b"Dear diary,\n")
    done = run("fit", f"{url}?{SECRET}", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr.startswith(f"Error: {url}: found no rows of numbers; the first line is 'Dear diary,'")


def test_a_forgotten_command_shows_no_secret(tmp_path: Path) -> None:
    """The proposed command works once the query is added."""
    done = run(f"https://host/log.mcap?{SECRET}", cwd=tmp_path)
    assert done.returncode == 2
    assert "to fit a log, type 'imucal fit https://host/log.mcap'" in done.stderr
    assert "SECRET" not in done.stderr


@pytest.mark.parametrize(
    ("url", "public", "name"),
    [
        ("https://me:a@host:80/x/log.mcap?sig=1#part", "https://host:80/x/log.mcap", "log.mcap"),
        ("HTTP://host/L%C3%A4ufe/log%201.csv", "http://host/L%C3%A4ufe/log%201.csv", "log 1.csv"),
        ("s3://bucket/what?.csv", "s3://bucket/what?.csv", "what_.csv"),
        ("az://key:a@container/x/", "az://container/x/", "x"),
        ("abfs://c@account.dfs/a.csv", "abfs://c@account.dfs/a.csv", "a.csv"),
        ("https://host", "https://host", "log"),
        ("gs://b/" + "a" * 300 + ".mcap", "gs://b/" + "a" * 300 + ".mcap", "a" * 195 + ".mcap"),
        ("folder/what?.csv", "folder/what?.csv", None),
    ],
)
def test_urls_are_shown_without_secrets(url: str, public: str, name: str | None) -> None:
    """User, query and fragment are removed; local paths do not change."""
    assert shown(url) == public
    assert is_url(url) == (name is not None)
    if name is not None:
        assert name_of(url) == name


def test_reports_of_remote_logs_are_named_after_the_log() -> None:
    """Report folders are in the current folder."""
    assert report_folder(f"https://host/x/still.mcap?{SECRET}") == Path("still-imucal")
    assert report_folder("s3://bucket/runs/monday/", "decomposed") == Path("monday-decomposed")


def test_wildcards_in_urls_are_recognised() -> None:
    """In a web address, a question mark starts the query."""
    assert has_wildcards("s3://bucket/a?.csv")
    assert has_wildcards("https://host/*.csv?sig=1")
    assert not has_wildcards("https://host/a[1].csv?sig=*")


def test_messages_of_libraries_contain_no_secrets() -> None:
    """A message can contain the URL and other URLs derived from it."""
    url = f"https://host/a.mcap?{SECRET}"
    text = f"400, url='{url}' (https://other/b?sig=SECRET2) failed"
    assert without_secrets(text, url) == "400, url='https://host/a.mcap' (https://other/b) failed"


@pytest.mark.parametrize("before", ["", "x" * 180])
def test_unknown_errors_of_libraries_contain_no_secrets(before: str) -> None:
    """The text is cut after 200 characters, perhaps within an address."""
    url = f"https://me:WORD{'9' * 40}@host/a.mcap?{SECRET}"
    error = explained(RuntimeError(f"{before} {url} {url.replace('a.mcap', 'b.mcap')}"), url, timeout_s=1)
    assert "https://" in str(error)
    assert not re.search("WORD|SECRET|me:", str(error))


def test_a_log_is_fetched_once_with_an_empty_cache(
    web: WebServer, tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The checksum needs no second download, and the log's `repr` contains no secret."""
    monkeypatch.setenv("IMUCAL_CACHE_SIZE", "0")
    url = web.add("/short.csv", one_axis())
    done = run("fit", url, "--model", "N", "--no-report", *OPTIONS, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(web.parts) == 1
    assert list(cache.glob("*/*")) == []
    assert "SECRET" not in repr(identify(f"{url}?{SECRET}"))


def test_the_key_of_a_log_depends_on_place_etag_and_size(web: WebServer) -> None:
    """The key has 32 digits."""
    first = identify(web.add("/a.csv", b"one"))
    assert len(first.key) == 32
    others = [("/b.csv", b"one", '"one"'), ("/a.csv", b"one", '"two"'), ("/a.csv", b"four", '"one"')]
    keys = {identify(web.add(path, body, etag=etag)).key for path, body, etag in others}
    assert len(keys | {first.key}) == 4

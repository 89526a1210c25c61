"""The page about remote logs, whose commands work, and the message of each failure."""

import importlib.util
import shlex
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fsspec
import pytest

import imucal
from imucal.errors import ReadError
from imucal.simulation import write_log
from tests.cli.run import SAMPLE_LOGS, run
from tests.code_blocks import code_blocks
from tests.remote.one_axis import one_axis
from tests.remote.web_server import WebServer

pytestmark = pytest.mark.usefixtures("cache", "no_waits")

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "remote-logs.md"


def typed(page: Path) -> list[str]:
    """Return the shell commands of the page."""
    return [line for language, text in code_blocks(page) if language == "sh" for line in text.splitlines()]


def test_the_commands_of_the_page_run(
    bucket: Any,  # noqa: ANN401
    web: WebServer,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The sample logs are in a bucket and behind a web server."""
    if not bucket.exists("lab"):
        bucket.mkdir("lab")
    bucket.put_file(SAMPLE_LOGS / "tactical.bag", "lab/monday/tactical.bag")
    recording = imucal.read(SAMPLE_LOGS / "tactical.bag")
    bucket.pipe_file("lab/monday/still.csv", one_axis())
    write_log(recording.between(0, 10), tmp_path / "bag")
    bucket.put(str(tmp_path / "bag"), "lab/bag", recursive=True)
    web.add("/with_gaps.csv", (SAMPLE_LOGS / "with_gaps.csv").read_bytes())
    for line in typed(PAGE):
        program, *words = shlex.split(line.replace("https://logs.example.org", web.url))
        if program == "python":
            exec(compile(words[-1], "the page", "exec"), {})  # noqa: S102 - our own page
            assert float(capsys.readouterr().out) == pytest.approx(50, rel=1e-3)
            continue
        words = words[: words.index(">")] if ">" in words else words
        done = run(*words, cwd=tmp_path)
        assert done.returncode == 0, f"{line}: {done.stderr}"
        assert "0815" not in done.stdout + done.stderr
    assert (tmp_path / "monday" / "report.json").exists()


class Changing(list[int]):
    """Lengths of answers, which are complete; the object changes after each answer."""

    def __init__(self, web: WebServer, path: str) -> None:
        super().__init__()
        self._web, self._path, self._count = web, path, 0

    def __bool__(self) -> bool:
        return True

    def pop(self, _: object = 0) -> int:
        self._count += 1
        self._web.add(self._path, BODY, etag=f'"{self._count}"', cuts=self)
        return len(BODY)


BODY = b"t,gx,gy,gz,ax,ay,az\n" + b"0,0,0,0,0,0,9.8\n" * 2000
Patch = pytest.MonkeyPatch


def _no_credentials(web: WebServer, patch: Patch) -> str:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_PROFILE"):
        patch.delenv(name, raising=False)
    patch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    patch.setenv("AWS_ENDPOINT_URL", web.url)
    fsspec.get_filesystem_class("s3").clear_instance_cache()
    return "s3://logs/nobody.csv"


def _no_host(web: WebServer, patch: Patch) -> str:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(-2, "Name or service not known")

    del web
    patch.setattr(socket, "getaddrinfo", unknown)
    return "http://host.invalid/log.csv"


def _late(web: WebServer, patch: Patch) -> str:
    patch.setenv("IMUCAL_REMOTE_TIMEOUT", "0.05")
    return web.add("/log.csv", BODY, delay_s=0.5)


def _without_package(web: WebServer, patch: Patch) -> str:
    find = importlib.util.find_spec
    patch.setattr(importlib.util, "find_spec", lambda name: None if name == "aiohttp" else find(name))
    return f"{web.url}/log.mcap"


def _no_room(web: WebServer, patch: Patch) -> str:
    patch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    return web.add("/log.csv", BODY)


def _changing(web: WebServer, patch: Patch) -> str:
    del patch
    return web.add("/log.csv", BODY, cuts=Changing(web, "/log.csv"))


#: A part of each message -> function that makes the server cause it and returns the address.
CASES: dict[str, Callable[[WebServer, Patch], str]] = {
    "the server answers": lambda web, _: web.add("/log.csv", BODY, statuses=[503] * 9),
    "there is no such": lambda web, _: f"{web.url}/missing.csv",
    "access is denied": lambda web, _: web.add("/log.csv", BODY, statuses=[403]),
    "no credentials, or": _no_credentials,
    "host not found": _no_host,
    "no answer within": _late,
    "the answer is a web page": lambda web, _: web.add("/log.csv", b"<!doctype html>" + BODY),
    "needs another package": _without_package,
    "the connection ended early": lambda web, _: web.add("/log.csv", BODY, cuts=[900] * 9),
    "the connection failed": lambda *_: "http://127.0.0.1:1/log.csv",
    "the server redirects": lambda web, _: web.add("/log.csv", b"", redirect="ftp://127.0.0.1/log.csv"),
    ":// is not supported": lambda *_: "sftp://host/log.csv",
    "no space for a remote log": _no_room,
    "it changed during the download": _changing,
}


@pytest.mark.parametrize("message", CASES)
def test_each_failure_has_its_message(message: str, web: WebServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """The exit code is 3, and the message contains no secret of the URL."""
    url = CASES[message](web, monkeypatch)
    secret = "?sig=SECRET" if url.startswith("http") else ""
    with pytest.raises(ReadError) as error:
        imucal.read(url + secret)
    assert message in str(error.value)
    assert error.value.exit_code == 3
    assert "sig=" not in str(error.value)

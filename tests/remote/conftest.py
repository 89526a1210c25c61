"""Servers, and a cache of each test's own."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from imucal.remote import failures
from tests.remote.web_server import WebServer, web_server

__all__ = ["cache", "no_waits", "web"]


@pytest.fixture
def web() -> Iterator[WebServer]:
    """Run a web server."""
    with web_server() as server:
        yield server


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the test an empty cache."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("IMUCAL_CACHE", str(folder))
    for name in ("IMUCAL_CACHE_SIZE", "IMUCAL_REMOTE_TIMEOUT", "http_proxy", "https_proxy", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    return folder


@pytest.fixture(autouse=True)
def no_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let attempts follow one another at once."""
    monkeypatch.setattr(failures, "WAITS", (0.0, 0.0, 0.0))

"""Servers, and a separate cache for each test."""

import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import fsspec
import pytest
from moto.server import ThreadedMotoServer

from imucal.remote import stores
from tests.remote.web_server import WebServer, web_server

__all__ = ["bucket", "cache", "endpoint", "no_waits", "web"]


@pytest.fixture
def web() -> Iterator[WebServer]:
    """Run a web server."""
    with web_server() as server:
        yield server


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the test an empty cache."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("IMUCAL_CACHE", str(folder))
    for name in ("IMUCAL_CACHE_SIZE", "IMUCAL_REMOTE_TIMEOUT", "http_proxy", "https_proxy", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    return folder


@pytest.fixture
def no_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Retry without waiting."""
    monkeypatch.setattr(stores, "WAITS", (0.0, 0.0, 0.0))


@pytest.fixture(scope="session")
def endpoint() -> Iterator[str]:
    """Run an S3 server, or use that of ``IMUCAL_TEST_S3``: ``http://key:secret@host:port``."""
    if "IMUCAL_TEST_S3" in os.environ:
        yield os.environ["IMUCAL_TEST_S3"]
        return
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://testing:testing@{host}:{port}"
    server.stop()


@pytest.fixture
def bucket(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Any:  # noqa: ANN401 - fsspec has no types
    """Give the test an empty bucket, and credentials in the environment."""
    parts = urlsplit(endpoint)
    for name, value in {
        "AWS_ENDPOINT_URL": f"{parts.scheme}://{parts.hostname}:{parts.port}",
        "AWS_ACCESS_KEY_ID": str(parts.username),
        "AWS_SECRET_ACCESS_KEY": str(parts.password),
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
    }.items():
        monkeypatch.setenv(name, value)
    # Another test may have left a connection without these credentials.
    fsspec.get_filesystem_class("s3").clear_instance_cache()
    files = fsspec.filesystem("s3", use_listings_cache=False)
    if files.exists("logs"):
        files.rm("logs", recursive=True)
    files.mkdir("logs")
    return files

"""A web server for files, with ranges and with typical faults of servers."""

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit


@dataclass(kw_only=True)
class Served:
    """A file of the server.

    `cuts` are the numbers of bytes after which the next answers to requests for parts break off (to all
    requests if it has no `ranges`), and `statuses` are the codes of the next answers. The server waits
    `delay_s` before each answer, and sends nothing after `stall_after` bytes. `head` is the length that a
    HEAD request reports; without it such requests are refused.
    """

    body: bytes
    etag: str | None = '"one"'
    modified: str | None = None
    kind: str = "application/octet-stream"
    ranges: bool = True
    length: bool = True
    cuts: list[int] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)
    delay_s: float = 0.0
    stall_after: int = 0
    head: int | None = None
    packing: str | None = None
    redirect: str = ""
    login: str = ""


class WebServer:
    """The files by their paths, and a list of requests."""

    def __init__(self) -> None:
        self.files: dict[str, Served] = {}
        self.asked: list[tuple[str, str, str]] = []
        self.url = ""
        self.closed = threading.Event()

    def add(self, path: str, body: bytes, **more: object) -> str:
        """Serve a file; return its URL."""
        self.files[path] = Served(body=body, **more)  # type: ignore[arg-type]
        return self.url + path

    @property
    def parts(self) -> list[str]:
        """Return the ranges of the requests for parts."""
        return [part for _, part, _ in self.asked if part]


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    web: WebServer

    def do_GET(self) -> None:
        path, part = unquote(urlsplit(self.path).path), self.headers.get("Range", "")
        self.web.asked.append((self.path, part, self.headers.get("Authorization", "")))
        file = self.web.files.get(path)
        if file is None:
            self._say(404)
            return
        time.sleep(file.delay_s)
        if file.statuses and (code := file.statuses.pop(0)) != 200:
            self._say(code)
        elif file.redirect:
            self._say(302, {"Location": file.redirect})
        elif file.login and self.headers.get("Authorization") != file.login:
            self._say(401)
        else:
            self._send(file, part)

    def do_HEAD(self) -> None:
        """Refuse unless a length is set: addresses may be signed only for GET."""
        file = self.web.files.get(unquote(urlsplit(self.path).path))
        if file is None or file.head is None:
            self._say(403)
            return
        self.send_response(200)
        self.send_header("Content-Length", str(file.head))
        self.send_header("ETag", file.etag or "")
        self.end_headers()

    def _send(self, file: Served, part: str) -> None:
        headers = {"ETag": file.etag, "Last-Modified": file.modified, "Content-Type": file.kind}
        headers["Content-Encoding"] = file.packing
        size, data, code = len(file.body), file.body, 200
        if part and file.ranges:
            match = re.fullmatch(r"bytes=(\d+)-(\d*)", part)
            assert match
            start, stop = int(match[1]), min(int(match[2] or size - 1) + 1, size)
            if start >= size:
                self._say(416, {"Content-Range": f"bytes */{size}"})
                return
            data, code = file.body[start:stop], 206
            headers["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
        self.send_response(code)
        for name, value in headers.items():
            if value is not None:
                self.send_header(name, value)
        if file.length:
            self.send_header("Content-Length", str(len(data)))
        else:
            self.send_header("Connection", "close")
            self.close_connection = True
        self.end_headers()
        if file.cuts and (part or not file.ranges):
            data = data[: file.cuts.pop(0)]
            self.close_connection = True
        if file.stall_after and len(data) > file.stall_after:
            self.wfile.write(data[: file.stall_after])
            self.web.closed.wait(60)
            return
        self.wfile.write(data)

    def _say(self, code: int, headers: dict[str, str] | None = None) -> None:
        self.send_response(code)
        for name, value in {**(headers or {}), "Content-Length": "0"}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Log nothing."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, *_: object) -> None:
        """Ignore clients that disconnect."""


@contextmanager
def web_server() -> Iterator[WebServer]:
    """Run a server on a free port of this machine."""
    web = WebServer()
    handler = type("Handler", (_Handler,), {"web": web})
    with _Server(("127.0.0.1", 0), handler) as server:
        web.url = f"http://127.0.0.1:{server.server_address[1]}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield web
        finally:
            web.closed.set()
            server.shutdown()
            thread.join()

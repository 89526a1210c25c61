"""The parts of Google Cloud Storage and Azure Blob Storage that are needed to read one object."""

import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, unquote, urlsplit

#: Object in a bucket, or container, with the name `bucket`.
NAME = "run/a.csv"
#: The public key of Azure's emulator, which is no secret.
_KEY = "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw=="
_DATE = "Thu, 01 Jan 2026 00:00:00 GMT"


class _Cloud(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    body = b""

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        query = {name: values[0] for name, values in parse_qs(parts.query).items()}
        path = unquote(parts.path)
        if path.startswith("/storage/") and query.get("alt") != "media":
            self._google(path, query)
        elif query.get("comp") == "list":
            self._azure_list(query)
        elif path.endswith(NAME):
            self._part()
        else:
            kind = {"Content-Type": "application/xml", "x-ms-error-code": "BlobNotFound"}
            self._say(404, b"<?xml version='1.0'?><Error><Code>BlobNotFound</Code></Error>", kind)

    def _google(self, path: str, query: dict[str, str]) -> None:
        item = {"name": NAME, "bucket": "bucket", "size": str(len(self.body)), "etag": "CJ9=",
                "updated": "2026-01-01T00:00:00Z", "generation": "1"}  # fmt: skip
        kind = {"Content-Type": "application/json"}
        if path.endswith(f"/o/{NAME}"):
            self._say(200, json.dumps(item).encode(), kind)
        elif path.rstrip("/").endswith("/o"):
            items = [item] if NAME.startswith(query.get("prefix", "")) else []
            self._say(200, json.dumps({"items": items}).encode(), kind)
        else:
            self._say(404, b'{"error": {"code": 404, "message": "Not Found"}}', kind)

    def _azure_list(self, query: dict[str, str]) -> None:
        blob = (
            f"<Blob><Name>{NAME}</Name><Properties><Last-Modified>{_DATE}</Last-Modified><Etag>0x8D</Etag>"
            f"<Creation-Time>{_DATE}</Creation-Time><Content-Length>{len(self.body)}</Content-Length>"
            "<Content-Type>text/csv</Content-Type><BlobType>BlockBlob</BlobType></Properties></Blob>"
        )
        found = blob if NAME.startswith(query.get("prefix", "")) else ""
        listed = f"<Blobs>{found}</Blobs><NextMarker/>"
        text = (
            f"<?xml version='1.0'?><EnumerationResults ContainerName='bucket'>{listed}</EnumerationResults>"
        )
        self._say(200, text.encode(), {"Content-Type": "application/xml"})

    def _part(self) -> None:
        size = len(self.body)
        part = self.headers.get("x-ms-range") or self.headers.get("Range") or "bytes=0-"
        match = re.match(r"bytes=(\d+)-(\d*)", part)
        assert match
        start, stop = int(match[1]), min(int(match[2] or size - 1) + 1, size)
        headers = {"ETag": '"0x8D"', "Last-Modified": _DATE, "x-ms-blob-type": "BlockBlob"}
        if self.command == "HEAD":
            self._say(200, self.body, headers)
        else:
            self._say(
                206, self.body[start:stop], {**headers, "Content-Range": f"bytes {start}-{stop - 1}/{size}"}
            )

    def _say(self, code: int, body: bytes, headers: dict[str, str]) -> None:
        self.send_response(code)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Log nothing."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, *_: object) -> None:
        """Ignore clients that disconnect."""


@contextmanager
def cloud_server(body: bytes) -> Iterator[dict[str, str]]:
    """Serve one object; yield the environment variables for gcsfs and adlfs."""
    handler = type("Handler", (_Cloud,), {"body": body})
    with _Server(("127.0.0.1", 0), handler) as server:
        url = f"http://127.0.0.1:{server.server_address[1]}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        account = f"AccountName=devstoreaccount1;AccountKey={_KEY};BlobEndpoint={url}/devstoreaccount1;"
        try:
            yield {
                "STORAGE_EMULATOR_HOST": url,
                # The emulator does not implement this request of Google's own protocol.
                "GCSFS_EXPERIMENTAL_ZB_HNS_SUPPORT": "false",
                "AZURE_STORAGE_CONNECTION_STRING": f"DefaultEndpointsProtocol=http;{account}",
            }
        finally:
            server.shutdown()
            thread.join()

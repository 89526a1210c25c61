"""A headless Chromium controlled through chromedriver's HTTP protocol (W3C WebDriver), stdlib only."""

import json
import re
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

import pytest

__all__ = ["Browser", "require_chromium"]

#: The browser's own requests must not be mistaken for requests of the page.
_ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1280,1000",
)
_KEYS = {"right": "\ue014", "left": "\ue012"}
_PATIENCE_S = 60.0


def require_chromium() -> tuple[str, str]:
    """Return the paths of Chromium and its driver, or skip the test."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if not (chromium and driver):
        pytest.skip("no Chromium: install chromium and chromium-driver to test the page in a browser")
    return chromium, driver


class Browser:
    """One session, used as a context manager."""

    def __init__(self) -> None:
        self._chromium, self._driver = require_chromium()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            profile = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
            command = [self._driver, "--port=0"]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)  # noqa: S603 - found in PATH
            stack.enter_context(process)
            stack.callback(process.terminate)
            self._base = f"http://127.0.0.1:{_port(process)}"
            options = {"binary": self._chromium, "args": [*_ARGUMENTS, f"--user-data-dir={profile}"]}
            logs = {"browser": "ALL", "performance": "ALL"}
            wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": logs}
            session = self._call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
            self._base += f"/session/{session['sessionId']}"
            stack.callback(self._call, "DELETE", "")
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def open(self, url: str) -> None:
        """Load a page and discard earlier log entries."""
        self.logs("performance")
        self.logs("browser")
        self._call("POST", "/url", {"url": url})

    def run(self, script: str, *arguments: object) -> Any:  # noqa: ANN401 - a JSON value
        """Return the result of a script."""
        return self._call("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, script: str) -> Any:  # noqa: ANN401 - a JSON value
        """Run a script until its result is true, and return the result."""
        return _until(lambda: self.run(script), script)

    def devtools(self, command: str, **parameters: object) -> Any:  # noqa: ANN401 - a JSON value
        """Return the answer of a DevTools command."""
        return self._call("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def point_at(self, x: float, y: float) -> None:
        """Move the mouse to a position in the viewport, in CSS pixels."""
        moves = [{"type": "pointerMove", "duration": 50, "x": round(x) + d, "y": round(y)} for d in (3, 0)]
        pointer = {
            "type": "pointer",
            "id": "mouse",
            "parameters": {"pointerType": "mouse"},
            "actions": moves,
        }
        self._call("POST", "/actions", {"actions": [pointer]})

    def press(self, key: str) -> None:
        """Press and release a key."""
        value = _KEYS[key]
        actions = [{"type": "keyDown", "value": value}, {"type": "keyUp", "value": value}]
        self._call("POST", "/actions", {"actions": [{"type": "key", "id": "keys", "actions": actions}]})

    def logs(self, kind: str) -> list[dict[str, Any]]:
        """Return the entries of a log since the last call."""
        entries: list[dict[str, Any]] = self._call("POST", "/se/log", {"type": kind})
        return entries

    def requests(self) -> list[str]:
        """Return the addresses that the page requested since it was opened."""
        events = [json.loads(entry["message"])["message"] for entry in self.logs("performance")]
        sent = [e["params"] for e in events if e["method"] == "Network.requestWillBeSent"]
        # Chromium's first tab is still loading its own parts.
        return [
            s["request"]["url"]
            for s in sent
            if not str(s.get("documentURL")).startswith(("chrome:", "chrome-"))
        ]

    def _call(self, method: str, path: str, body: object = None) -> Any:  # noqa: ANN401 - a JSON value
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(  # noqa: S310 - always http on this machine
            self._base + path, data=data, method=method, headers={"Content-Type": "application/json"}
        )
        with urllib.request.urlopen(request, timeout=60) as answer:  # noqa: S310
            return json.load(answer)["value"]


def _port(process: subprocess.Popen[str]) -> int:
    for line in process.stdout or ():
        if match := re.search(r"successfully on port (\d+)", line):
            return int(match[1])
    msg = "chromedriver ended before it said its port"
    raise RuntimeError(msg)


def _until(ask: Callable[[], Any], what: str) -> Any:  # noqa: ANN401 - a JSON value
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        if answer := ask():
            return answer
        time.sleep(0.1)
    pytest.fail(f"waited {_PATIENCE_S} s in vain for: {what}")

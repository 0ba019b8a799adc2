"""A headless Chromium of a test's own, driven through its DevTools protocol.

It starts with an empty profile and reaches this machine only; its processes end with the test.
"""

import base64
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
START_SECS = 60.0
CALL_SECS = 60.0
END_SECS = 20.0
LARGEST_ANSWER_BYTES = 64 << 20
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost, EXCLUDE 127.0.0.1",
    "--remote-debugging-port=0",
)
"""Software rendering; as root there is no sandbox; names other than this machine's do not resolve."""


class Chromium:
    """One page of a browser; what it asked for and complained of is collected while it is used."""

    def __init__(self, width_px: int = 1280, height_px: int = 720) -> None:
        self.requests: list[str] = []
        """Every address that the page asked for, also those that were blocked."""
        self.blocked: list[str] = []
        """Those that the content security policy stopped."""
        self.said: list[str] = []
        """What is in the console: level and text; without the viewer's debugging, of which there is much."""
        self.exceptions: list[str] = []
        self.loads = 0
        """How often the page was loaded."""
        self._size = (width_px, height_px)
        self._requested: dict[str, str] = {}
        self._calls = 0
        self._connected = ExitStack()

    def __enter__(self) -> Self:
        assert PROGRAM is not None
        self._profile = Path(tempfile.mkdtemp(prefix="babble-chromium-"))
        window = f"--window-size={self._size[0]},{self._size[1]}"
        self._child = subprocess.Popen(
            [PROGRAM, *FLAGS, window, f"--user-data-dir={self._profile}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            self._socket = self._connect()
            for domain in ("Page", "Network", "Runtime", "Log"):
                self.call(f"{domain}.enable")
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._connected.close()
        finally:
            self._end()

    def open(self, url: str) -> None:
        """Go to an address, and wait until the page itself is loaded."""
        before = self.loads
        self.call("Page.navigate", url=url)
        self.wait_for(f"the page at {url}", lambda: self.loads > before, START_SECS)

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression in the page; None for an object."""
        return self.call("Runtime.evaluate", expression=expression)["result"].get("value")

    def screenshot(self) -> bytes:
        """What the page shows, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot")["data"])

    def wait_for(self, what: str, look: Callable[[], Any], within_secs: float) -> Any:
        """The first true value of `look`, while events are collected; AssertionError at the deadline."""
        deadline_secs = time.monotonic() + within_secs
        while time.monotonic() < deadline_secs:
            if found := look():
                return found
            self._hear(0.2)
        raise AssertionError(f"waited {within_secs:.0f} s in vain for {what}: {self.said[-20:]}")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command; events that come before it are collected."""
        self._calls += 1
        number = self._calls
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        deadline_secs = time.monotonic() + CALL_SECS
        while (left_secs := deadline_secs - time.monotonic()) > 0:
            answer = self._hear(left_secs)
            if answer is not None and answer.get("id") == number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return dict(answer["result"])
        raise AssertionError(f"Chromium did not answer {method} within {CALL_SECS:.0f} s")

    def _hear(self, within_secs: float) -> dict[str, Any] | None:
        try:
            message = json.loads(self._socket.recv(timeout=within_secs))
        except TimeoutError:
            return None
        if "method" in message:
            self._collect(message["method"], message["params"])
        return dict(message)

    def _collect(self, event: str, told: dict[str, Any]) -> None:
        match event:
            case "Network.requestWillBeSent":
                self.requests.append(told["request"]["url"])
                self._requested[told["requestId"]] = told["request"]["url"]
            case "Network.loadingFailed" if told.get("blockedReason") == "csp":
                self.blocked.append(self._requested.get(told["requestId"], ""))
            case "Page.loadEventFired":
                self.loads += 1
            case "Runtime.consoleAPICalled" if told["type"] != "debug":
                words = [str(part.get("value", part.get("description", ""))) for part in told["args"]]
                self.said.append(f"{told['type']}: {' '.join(words)}")
            case "Log.entryAdded":
                self.said.append(f"{told['entry']['level']}: {told['entry']['text']}")
            case "Runtime.exceptionThrown":
                self.exceptions.append(json.dumps(told["exceptionDetails"])[:2000])

    def _connect(self) -> ClientConnection:
        """To the first page, once the browser has said at which port it listens."""
        told = self._profile / "DevToolsActivePort"
        deadline_secs = time.monotonic() + START_SECS
        while time.monotonic() < deadline_secs:
            assert self._child.poll() is None, f"{PROGRAM} ended with {self._child.returncode}"
            try:
                port = int(told.read_text().splitlines()[0])
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=5) as answer:
                    pages = [target for target in json.load(answer) if target["type"] == "page"]
                page = connect(pages[0]["webSocketDebuggerUrl"], max_size=LARGEST_ANSWER_BYTES)
                return self._connected.enter_context(page)
            except (OSError, ValueError, IndexError, WebSocketException):
                time.sleep(0.05)
        raise AssertionError(f"{PROGRAM} did not start within {START_SECS:.0f} s")

    def _end(self) -> None:
        """Kill the processes of our own session, and only them."""
        if self._child.poll() is None:
            os.killpg(self._child.pid, signal.SIGKILL)
            self._child.wait(END_SECS)
        shutil.rmtree(self._profile, ignore_errors=True)

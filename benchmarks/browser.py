"""A headless Chromium, driven over a pair of pipes by its DevTools protocol.

Nothing is downloaded: it is the machine's own browser, of whatever version, and a few dozen lines
are all that measuring and testing a page needs of a protocol that it has had for years.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
LIMIT = 60.0
"""Seconds for any answer; only a browser that hangs reaches it."""
SWITCHES = (
    *("--headless", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-extensions"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--hide-scrollbars", "--force-device-scale-factor=1", "--disable-dev-shm-usage"),
    # A container may not make a sandbox; the pages are our own.
    "--no-sandbox",
)


def find_browser() -> str | None:
    """The path of a Chromium, if the machine has one; `$PLAY_LAUNCH_BROWSER` names another."""
    named = os.environ.get("PLAY_LAUNCH_BROWSER")
    return named or next(filter(None, map(shutil.which, NAMES)), None)


class BrowserError(Exception):
    """The browser refused, or did not answer."""


class Browser:
    """One browser with one tab; ends with the context."""

    def __init__(self, program: str, profile: Path) -> None:
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        try:
            # The protocol's descriptors are 3 and 4; a shell puts ours there.
            script = f'exec nice -n 10 "$0" "$@" 3<&{to_browser} 4>&{from_browser}'
            self._process = subprocess.Popen(
                [
                    *("bash", "-c", script, program, *SWITCHES),
                    *(f"--user-data-dir={profile}", "--remote-debugging-pipe", "about:blank"),
                ],
                pass_fds=(to_browser, from_browser),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        finally:
            os.close(to_browser)
            os.close(from_browser)
        self._received = b""
        self._number = 0
        self._session = ""
        self.errors: list[str] = []
        """What the page reported to its console, or did not catch."""
        self.requests: list[str] = []
        """Addresses that the page asked for."""

    def __enter__(self) -> Self:
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(each["targetId"] for each in targets if each["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=page, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._session = ""
        try:
            self.call("Browser.close")
        except BrowserError:
            self._process.kill()
        finally:
            os.close(self._write)
            os.close(self._read)
            self._process.wait(LIMIT)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol, and take what happens meanwhile."""
        self._number += 1
        request = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            request["sessionId"] = self._session
        os.write(self._write, json.dumps(request).encode() + b"\0")
        while True:
            message = self._message()
            if message.get("id") != self._number:
                self._happened(message)
                continue
            if "error" in message:
                raise BrowserError(f"{method}: {message['error']['message']}")
            result: dict[str, Any] = message["result"]
            return result

    def _message(self) -> dict[str, Any]:
        deadline = time.monotonic() + LIMIT
        while b"\0" not in self._received:
            ready, _, _ = select.select([self._read], [], [], max(0, deadline - time.monotonic()))
            data = os.read(self._read, 1 << 20) if ready else b""
            if not data:
                raise BrowserError("the browser is gone" if ready else "no answer")
            self._received += data
        first, _, self._received = self._received.partition(b"\0")
        message: dict[str, Any] = json.loads(first)
        return message

    def _happened(self, message: dict[str, Any]) -> None:
        values = message.get("params", {})
        match message.get("method"):
            case "Runtime.exceptionThrown":
                details = values["exceptionDetails"]
                thrown = details.get("exception", {})
                self.errors.append(thrown.get("description") or details["text"])
            case "Runtime.consoleAPICalled" if values["type"] in {"error", "warning", "assert"}:
                self.errors.append(str(values["args"]))
            case "Log.entryAdded":
                self.errors.append(f"{values['entry']['text']} {values['entry'].get('url', '')}")
            case "Network.requestWillBeSent":
                self.requests.append(values["request"]["url"])

    def open(self, page: Path) -> None:
        """Open a file and wait until the report is whole."""
        self.errors.clear()
        self.requests.clear()
        self.call("Page.navigate", url=page.as_uri())
        self.until("document.documentElement.dataset.ready === 'yes' || !byId('failed').hidden")

    def run(self, script: str) -> Any:
        """Give the value of an expression on the page."""
        answer = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise BrowserError(answer["exceptionDetails"].get("exception", {}).get("description"))
        return answer["result"].get("value")

    def until(self, condition: str) -> None:
        """Wait until an expression holds, also over a change of pages."""
        script = (
            "new Promise((done) => { const look = () => { let holds = false;"
            f"try {{ holds = ({condition}); }} catch (error) {{ }}"
            "if (holds) done(true); else setTimeout(look, 10); }; look(); })"
        )
        deadline = time.monotonic() + LIMIT
        while True:
            try:
                self.run(script)
            except BrowserError:
                # The page went away for the one that was asked for.
                if time.monotonic() > deadline:
                    raise
            else:
                return

    def drawn(self) -> None:
        """Wait until what was asked for is drawn."""
        self.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def press(self, key: str, text: str | None = None) -> None:
        """Press and release a key."""
        written = key if len(key) == 1 else ""
        typed = written if text is None else text
        down = {"type": "keyDown", "key": key, "text": typed} if typed else {"type": "rawKeyDown"}
        self.call("Input.dispatchKeyEvent", **{"key": key, **down})
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)
        self.drawn()

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Move (``mouseMoved``), press, release or turn the wheel at a place of the view."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        """Click at a place of the view."""
        self.mouse("mouseMoved", x, y)
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y, button="left", buttons=1, clickCount=1)
        self.drawn()

    def size(self, width: int, height: int) -> None:
        """Give the view a size in pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def prefer(self, scheme: str) -> None:
        """Let the reader prefer ``light`` or ``dark``."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.call("Emulation.setEmulatedMedia", features=features)

    def picture(self, path: Path) -> None:
        """Write what is in view as PNG."""
        shot = self.call("Page.captureScreenshot", format="png")
        path.write_bytes(base64.b64decode(shot["data"]))

    def paper(self) -> bytes:
        """Print the page; give the PDF."""
        printed = self.call("Page.printToPDF", printBackground=True, landscape=True)
        return base64.b64decode(printed["data"])

"""A headless Chromium for tests of pages, driven over its debugging pipe."""

import json
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Browser:
    """One page of a headless Chromium, driven over its debugging pipe (JSON ended by NUL)."""

    def __init__(self, profile: Path, *flags: str, within: Sequence[str] = ()) -> None:
        """`flags` are added to the browser's; `within` is a command that runs another, as in a namespace."""
        read, its_write = os.pipe()
        its_read, write = os.pipe()
        command = [
            *within,
            "bash",
            "-c",
            f'exec "$@" 3<&{its_read} 4>&{its_write}',
            "bash",
            str(CHROMIUM),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            f"--user-data-dir={profile}",
            *flags,
            "--remote-debugging-pipe",
        ]
        self._process = subprocess.Popen(
            command, pass_fds=(its_read, its_write), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        os.close(its_read)
        os.close(its_write)
        self._reader, self._writer = os.fdopen(read, "rb"), os.fdopen(write, "wb", buffering=0)
        self._pending = b""
        self._sent = 0
        self._session: str | None = None
        self.complaints: list[Any] = []
        self._workers: dict[str, str] = {}
        """Sessions of the page's workers, by the address of their script."""
        self._loaded = False

    def start(self) -> None:
        target = self.do("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.do("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.do(f"{domain}.enable")

    def do(self, method: str, **params: Any) -> dict[str, Any]:
        self._sent += 1
        message = {"id": self._sent, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._writer.write(json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._sent:
                assert "error" not in answer, answer
                return answer["result"]

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._pending:
            data = os.read(self._reader.fileno(), 1 << 16)
            assert data, "the browser is gone"
            self._pending += data
        line, _, self._pending = self._pending.partition(b"\0")
        message: dict[str, Any] = json.loads(line)
        if message.get("method") in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
            self.complaints.append(message["params"])
        if message.get("method") == "Target.attachedToTarget":
            self._workers[message["params"]["targetInfo"]["url"]] = message["params"]["sessionId"]
        self._loaded |= message.get("method") == "Page.loadEventFired"
        return message

    def open(self, page: Path | str, *, width: int = 1280, height: int = 900, angle: int = 0) -> None:
        """Open a file or a URL on a screen of that size, turned by an angle, and wait until it is loaded."""
        size = {"width": width, "height": height, "screenWidth": width, "screenHeight": height}
        turned = ("landscape" if width > height else "portrait") + (
            "Secondary" if angle >= 180 else "Primary"
        )
        self.do(
            "Emulation.setDeviceMetricsOverride",
            **size,
            deviceScaleFactor=1,
            mobile=False,
            screenOrientation={"type": turned, "angle": angle},
        )
        self._loaded = False
        self.do("Page.navigate", url=page.as_uri() if isinstance(page, Path) else page)
        while not self._loaded:
            self._receive()

    def ask(self, expression: str, *, wait: bool = False) -> Any:
        """The value of an expression, of a promise's if `wait`."""
        answer = self.do("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=wait)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def ask_worker(self, script: str, expression: str) -> Any:
        """The value of an expression in the worker whose script's address ends so."""
        self.do("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=False, flatten=True)
        page = self._session
        try:
            while not (found := [one for url, one in self._workers.items() if url.endswith(script)]):
                self._receive()
            self._session = found[-1]
            return self.ask(expression)
        finally:
            self._session = page

    def wait_until(self, condition: str) -> None:
        """Return once an expression is true; after ten seconds it is an error."""
        look = f"""new Promise((done, fail) => {{
          setTimeout(() => fail(new Error("never came true")), 10000);
          const look = () => {condition} ? done() : setTimeout(look, 20);
          look();
        }})"""
        self.ask(look, wait=True)

    def point(self, selector: str, *shares: float) -> list[tuple[float, float]]:
        """Points on the screen, px, at these shares of an element's width and half its height."""
        left, top, wide, high = self.ask(
            "(r => [r.left, r.top, r.width, r.height])"
            f"(document.querySelector({json.dumps(selector)}).getBoundingClientRect())"
        )
        return [(left + share * wide, top + high / 2) for share in shares]

    def prefer(self, **features: str) -> None:
        """Media features such as prefers-color-scheme; those not named are the browser's own."""
        wanted = [{"name": name, "value": value} for name, value in features.items()]
        self.do("Emulation.setEmulatedMedia", features=wanted)

    def press(self, key: str, code: int, *, text: str = "") -> None:
        for kind in ("keyDown" if text else "rawKeyDown", "keyUp"):
            self.do(
                "Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, text=text
            )

    def click(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.do("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        steps = (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end))
        for kind, (x, y) in steps:
            self.do("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def hide(self) -> None:
        """Put another tab before the page, as when another app is opened."""
        page, self._session = self._session, None
        try:
            self.do("Target.createTarget", url="about:blank")
        finally:
            self._session = page

    def kill(self) -> None:
        """End it at once, as a system does that needs its memory."""
        self._process.kill()
        self._process.wait()
        self._reader.close()
        self._writer.close()

    def close(self) -> None:
        try:
            self._session = None
            self.do("Browser.close")
            self._process.wait(20)
        finally:
            self._process.kill()
            self._process.wait()
            self._reader.close()
            self._writer.close()

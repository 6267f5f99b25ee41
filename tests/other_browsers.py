"""Firefox (by Marionette) and WebKitGTK (by its WebDriver), each with a fake camera, for tests of pages."""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

FIREFOX = next(filter(None, map(shutil.which, ("firefox-esr", "firefox"))), None)
WEBKIT_DRIVER, XVFB = shutil.which("WebKitWebDriver"), shutil.which("Xvfb")
MINI_BROWSER = next(Path("/usr/lib").glob("*/webkit2gtk-4.1/MiniBrowser"), None)
START_S = 60.0
T = TypeVar("T")
PREFERENCES = {
    "media.navigator.streams.fake": True,
    "media.navigator.permission.disabled": True,
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "app.update.enabled": False,
    "network.captive-portal-service.enabled": False,
}


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def within_start(attempt: Callable[[], T]) -> T:
    """Repeat what fails with an OSError until the browser listens."""
    end_s = time.monotonic() + START_S
    while True:
        try:
            return attempt()
        except OSError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.2)


class Firefox:
    """One page of a headless Firefox, driven over its Marionette port (`LENGTH:JSON`)."""

    def __init__(self, profile: Path) -> None:
        assert FIREFOX
        profile.mkdir()
        port = free_port()
        chosen = PREFERENCES | {"marionette.port": port}
        lines = (f"user_pref({json.dumps(name)}, {json.dumps(value)});\n" for name, value in chosen.items())
        (profile / "user.js").write_text("".join(lines))
        command = [FIREFOX, "--headless", "--marionette", "--no-remote", "--profile", str(profile)]
        self._process = start(command, {"HOME": str(profile)})
        self._socket = within_start(lambda: socket.create_connection(("127.0.0.1", port)))
        self._socket.settimeout(120.0)
        self._file = self._socket.makefile("rb")
        self._sent = 0
        self._read()
        session = self._do("WebDriver:NewSession", {"acceptInsecureCerts": True})
        self.version = f"Firefox {session['capabilities']['browserVersion']}"

    def open(self, url: str) -> None:
        self._do("WebDriver:Navigate", {"url": url})

    def ask(self, expression: str) -> Any:
        return self._do("WebDriver:ExecuteScript", {"script": f"return ({expression})", "args": []})["value"]

    def kill(self) -> None:
        self._socket.close()
        end(self._process)

    def _do(self, name: str, parameters: dict[str, Any]) -> Any:
        self._sent += 1
        message = json.dumps([0, self._sent, name, parameters])
        self._socket.sendall(f"{len(message.encode())}:{message}".encode())
        _, number, error, result = self._read()
        assert (number, error) == (self._sent, None), error
        return result

    def _read(self) -> Any:
        length = b""
        while not length.endswith(b":"):
            byte = self._file.read(1)
            assert byte, "the browser is gone"
            length += byte
        return json.loads(self._file.read(int(length[:-1])))


class WebKit:
    """One page of WebKitGTK's MiniBrowser on a display of its own, driven by its WebDriver."""

    def __init__(self, profile: Path) -> None:
        assert WEBKIT_DRIVER
        assert XVFB
        profile.mkdir()
        read, write = os.pipe()
        display = [XVFB, "-displayfd", str(write), "-screen", "0", "800x1000x24", "-nolisten", "tcp"]
        self._processes = [start(display, {}, pass_fds=(write,))]
        os.close(write)
        with os.fdopen(read) as file:
            number = file.readline().strip()
        port = free_port()
        home = {"DISPLAY": f":{number}", "HOME": str(profile), "GDK_BACKEND": "x11"}
        self._processes.append(start([WEBKIT_DRIVER, f"--port={port}"], home))
        self._base = f"http://127.0.0.1:{port}/session"
        flags = ["--automation", "--enable-media-stream=true", "--enable-mock-capture-devices=true"]
        options = {"binary": str(MINI_BROWSER), "args": flags}
        wanted = {"acceptInsecureCerts": True, "webkitgtk:browserOptions": options}
        session = within_start(lambda: self._call("", {"capabilities": {"alwaysMatch": wanted}}))
        self._base += f"/{session['sessionId']}"
        self.version = f"WebKitGTK {session['capabilities']['browserVersion']}"

    def open(self, url: str) -> None:
        self._call("/url", {"url": url})

    def ask(self, expression: str) -> Any:
        return self._call("/execute/sync", {"script": f"return ({expression})", "args": []})

    def kill(self) -> None:
        with contextlib.suppress(OSError):
            urllib.request.urlopen(urllib.request.Request(self._base, method="DELETE"), timeout=5)
        for process in reversed(self._processes):
            end(process)

    def _call(self, path: str, body: dict[str, Any]) -> Any:
        request = urllib.request.Request(self._base + path, json.dumps(body).encode())
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise AssertionError(error.read().decode()) from error


def start(command: list[str], environment: dict[str, str], **options: Any) -> subprocess.Popen[bytes]:
    """Start a browser's process, whose children end with it."""
    options |= {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    return subprocess.Popen(command, env=os.environ | environment, **options)


def end(process: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()

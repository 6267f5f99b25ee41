"""The process-wide libcamera manager: its cameras, and dispatch of finished requests to their cameras."""

import asyncio
import functools
import os
import re
from collections.abc import Callable
from itertools import count
from typing import Any

from capture_app.cameras.system_packages import load_system_module
from capture_app.common.errors import CameraError, NotAvailableError

PACKAGE = "python3-libcamera"
MIN_VERSION = (0, 4)
"""The oldest version that was tested."""

OnRequest = Callable[[Any], None]


class Library:
    """libcamera's Python module with its camera manager, of which a process has one."""

    def __init__(self, module: Any) -> None:
        """Connect to the camera manager. Raises NotAvailableError if the library is too old."""
        self.module = module
        self._manager = module.CameraManager.singleton()
        version = str(self._manager.version)
        found = re.match(r"v?(\d+)\.(\d+)", version)
        if found is None or (int(found[1]), int(found[2])) < MIN_VERSION:
            raise NotAvailableError(
                f"libcamera {version} is too old: {'.'.join(map(str, MIN_VERSION))} or newer is needed",
                hint="install Debian 13 or an up-to-date Raspberry Pi OS",
            )
        self._handlers: dict[int, OnRequest] = {}
        self._cookies = count()

    @property
    def cameras(self) -> list[Any]:
        """All cameras that libcamera has found."""
        return list(self._manager.cameras)

    def camera(self, device: str) -> Any:
        """Return the camera with that id or number in the list. Raises CameraError."""
        cameras = self.cameras
        for number, camera in enumerate(cameras):
            if device in (camera.id, str(number)):
                return camera
        known = f"it knows {', '.join(camera.id for camera in cameras)}" if cameras else "it knows none"
        raise CameraError(
            f"libcamera knows no camera {device}", hint=f"{known}; `capture-app cameras` lists them"
        )

    def new_request(self, camera: Any, on_finish: OnRequest) -> Any:
        """Create a request of a camera; `on_finish` is called with it each time it finishes."""
        cookie = next(self._cookies)
        self._handlers[cookie] = on_finish
        return camera.create_request(cookie)

    def forget(self, requests: list[Any]) -> None:
        """Remove the handlers of these requests."""
        for request in requests:
            self._handlers.pop(request.cookie, None)

    def listen(self) -> None:
        """Dispatch finished requests on the running event loop, until `hush` finds no handler left."""
        asyncio.get_running_loop().add_reader(self._manager.event_fd, self.dispatch)

    def hush(self) -> None:
        """Stop dispatching once no handler is left."""
        if not self._handlers:
            asyncio.get_running_loop().remove_reader(self._manager.event_fd)

    def dispatch(self) -> None:
        """Call the handlers of all finished requests."""
        for request in self._manager.get_ready_requests():
            if handler := self._handlers.get(request.cookie):
                handler(request)


_library_of = functools.cache(Library)


def load_library() -> Library:
    """Return the library of this process. Raises NotAvailableError if it is missing, too old, or broken."""
    # It logs to stderr, where users read this program's messages.
    os.environ.setdefault("LIBCAMERA_LOG_LEVELS", "*:FATAL")
    module = load_system_module("libcamera", PACKAGE, "a camera of libcamera")
    return _library_of(module)

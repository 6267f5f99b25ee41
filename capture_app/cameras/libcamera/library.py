"""The library of this process: found, its cameras, and each finished request to the camera that it is of."""

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
LEAST_VERSION = (0, 4)
"""The oldest that was tried."""

OnRequest = Callable[[Any], None]


class Library:
    """libcamera's Python module with its camera manager, of which a process has one."""

    def __init__(self, module: Any) -> None:
        """Raises NotAvailableError for a library that is too old."""
        self.module = module
        self._manager = module.CameraManager.singleton()
        version = str(self._manager.version)
        found = re.match(r"v?(\d+)\.(\d+)", version)
        if found is None or (int(found[1]), int(found[2])) < LEAST_VERSION:
            least = ".".join(map(str, LEAST_VERSION))
            raise NotAvailableError(
                f"libcamera {version} is too old: {least} or newer is needed",
                hint="Debian 13 and an up-to-date Raspberry Pi OS have it",
            )
        self._handlers: dict[int, OnRequest] = {}
        self._cookies = count()

    @property
    def cameras(self) -> list[Any]:
        """The library's cameras."""
        return list(self._manager.cameras)

    def camera(self, device: str) -> Any:
        """The camera with that id, or number in the list. Raises CameraError."""
        cameras = self.cameras
        for number, camera in enumerate(cameras):
            if device in (camera.id, str(number)):
                return camera
        known = f"it knows {', '.join(camera.id for camera in cameras)}" if cameras else "it knows none"
        raise CameraError(
            f"libcamera knows no camera {device}", hint=f"{known}; `capture-app cameras` lists them"
        )

    def new_request(self, camera: Any, on_finish: OnRequest) -> Any:
        """A request of a camera; `on_finish` is called with it each time that it is finished."""
        cookie = next(self._cookies)
        self._handlers[cookie] = on_finish
        return camera.create_request(cookie)

    def forget(self, requests: list[Any]) -> None:
        """Call nobody for these requests any more."""
        for request in requests:
            self._handlers.pop(request.cookie, None)

    def listen(self) -> None:
        """Dispatch finished requests on the running loop, until `hush` is called when all are forgotten."""
        asyncio.get_running_loop().add_reader(self._manager.event_fd, self.dispatch)

    def hush(self) -> None:
        """Dispatch no more where no request is left."""
        if not self._handlers:
            asyncio.get_running_loop().remove_reader(self._manager.event_fd)

    def dispatch(self) -> None:
        """Hand out the requests that are finished."""
        for request in self._manager.get_ready_requests():
            handler = self._handlers.get(request.cookie)
            if handler is not None:
                handler(request)


_library_of = functools.cache(Library)


def load_library() -> Library:
    """The library of this process. Raises NotAvailableError if it is missing, too old, or does not load."""
    # It logs to stderr, where a user reads what this program says.
    os.environ.setdefault("LIBCAMERA_LOG_LEVELS", "*:FATAL")
    module = load_system_module("libcamera", PACKAGE, "a camera of libcamera")
    return _library_of(module)

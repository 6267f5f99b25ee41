"""A double of libcamera's Python module: sensors that obey whole rows, two frames after a request says so.

Modelled after the Raspberry Pi's pipeline: a request's settings are taken in when its frame begins, and are
in effect two frames later; durations and exposures become whole rows, told in whole microseconds; a frame
without a request is lost; the first row's exposure ends where the frame is stamped. Nothing else is modelled.
Time is the running loop's.
"""

import os
from types import SimpleNamespace
from typing import Any

from tests.unit.plugins.cameras.libcamera.double_camera import (
    PLANES,
    Camera,
    ConfigurationStatus,
    FrameStatus,
    PixelFormat,
    Request,
    Sensor,
    Size,
    Status,
)


class CameraManager:
    def __init__(self, sensors: list[Sensor], version: str = "v0.4.0") -> None:
        self.version = version
        self.cameras = [
            Camera(self, f"/base/i2c/{sensor.model}@{n}", sensor) for n, sensor in enumerate(sensors)
        ]
        self.event_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._ready: list[Request] = []

    def finish(self, request: Request) -> None:
        self._ready.append(request)
        os.eventfd_write(self.event_fd, 1)

    def get_ready_requests(self) -> list[Request]:
        ready, self._ready = self._ready, []
        if ready:
            os.eventfd_read(self.event_fd)
        return ready

    def close(self) -> None:
        os.close(self.event_fd)


class FrameBufferAllocator:
    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def allocate(self, stream: Any) -> int:
        self._buffers = [self._buffer() for _ in range(self._camera.buffer_count)]
        return len(self._buffers)

    def buffers(self, stream: Any) -> list[Any]:
        return self._buffers

    def __del__(self) -> None:
        for buffer in self._buffers:
            os.close(buffer.planes[0].fd)

    @staticmethod
    def _buffer() -> Any:
        fd = os.memfd_create("buffer")
        os.truncate(fd, 64 * 72)
        return SimpleNamespace(
            planes=[SimpleNamespace(fd=fd, offset=offset, length=length) for offset, length in PLANES],
            metadata=None,
        )


def libcamera_double(*sensors: Sensor, version: str = "v0.4.0") -> Any:
    """What `import libcamera` would give on a machine with these sensors."""
    manager = CameraManager(list(sensors), version)
    return SimpleNamespace(
        CameraManager=SimpleNamespace(singleton=lambda: manager),
        Request=SimpleNamespace(Status=Status),
        FrameMetadata=SimpleNamespace(Status=FrameStatus),
        CameraConfiguration=SimpleNamespace(Status=ConfigurationStatus),
        StreamRole=SimpleNamespace(VideoRecording="video"),
        PixelFormat=PixelFormat,
        Size=Size,
        FrameBufferAllocator=FrameBufferAllocator,
    )

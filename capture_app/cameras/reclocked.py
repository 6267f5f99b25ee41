"""A camera whose driver stamps in the host's monotonic clock, in a node whose clock runs otherwise."""

from dataclasses import replace

from capture_app.camera_facts import CameraFacts
from capture_app.cameras.base import Camera, CapturedFrame, OnFailure, OnFrame
from capture_app.clock import HostClock, NodeClock
from capture_app.session.format.calibration import CameraCalibration
from capture_app.sync.wire.camera_commands import CameraCommand


class ReclockedCamera(Camera):
    """Passes everything through and translates each frame's timestamp into the node's clock."""

    def __init__(self, camera: Camera, clock: NodeClock) -> None:
        self._camera = camera
        self._clock = clock

    @property
    def facts(self) -> CameraFacts:
        """What the camera behind it is and can do."""
        return self._camera.facts

    @property
    def calibration(self) -> CameraCalibration | None:
        """That of the camera behind it."""
        return self._camera.calibration

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start the camera behind it. Raises what that camera raises."""

        def deliver(frame: CapturedFrame) -> None:
            on_frame(replace(frame, timestamp_ns=self._clock.local_from_true(frame.timestamp_ns)))

        await self._camera.start(deliver, on_failure)

    async def apply(self, command: CameraCommand) -> None:
        """Hand the command on. Raises what the camera behind it raises."""
        await self._camera.apply(command)

    async def stop(self) -> None:
        """Stop the camera behind it."""
        await self._camera.stop()


def in_node_clock(camera: Camera, clock: NodeClock) -> Camera:
    """The camera with its frames stamped in a node's clock; itself where that is the host's."""
    return camera if isinstance(clock, HostClock) else ReclockedCamera(camera, clock)

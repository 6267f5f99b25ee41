"""The rig as the screens know it: updates in, orders out, over a connection to its leader.

`capture_app.node.operator.link.RigLink` is the real one. What it yields lies in `capture_app.node.wire`:
`RigStatus` in `status`, `NewsLine`, `Preview` and `NodeDetail` in `views`, `BurstRequest` in `messages`.
"""

from collections.abc import AsyncIterator
from typing import Protocol

from capture_app.net.address import Address
from capture_app.node.operator.camera_controls import ControlledCamera
from capture_app.node.operator.updates import Update
from capture_app.node.wire.messages import BurstRequest
from capture_app.node.wire.operating import PhoneInvited
from capture_app.node.wire.pairing import Invited
from capture_app.node.wire.status import BurstStatus
from capture_app.node.wire.views import NodeDetail


class RigSource(Protocol):
    """A leader and its cameras. All but `updates` raise SimulshotError: the leader's own, or NetworkError."""

    @property
    def leader(self) -> Address:
        """Where the leader is reached from here; `RigStatus.leader` is what other machines are told."""

    def updates(self) -> AsyncIterator[Update]:
        """Yield what changes, for ever: for one reader at a time.

        At first, and after each `LinkLost`, come the status and the latest news that were not yielded before;
        then a `RigStatus` whenever it has changed, at most ten a second. A lost connection is opened again
        and again; the first status after `LinkLost` says that it is back.
        """

    async def want_previews(self, *, cameras: tuple[str, ...] | None, width: int, fps: float) -> None:
        """Ask for small pictures of these cameras among the updates: None for all, 0 `fps` for none.

        At most `fps` a second of each, fewer where the link or the screen is slow, none while a burst is
        picked or sent. Kept over reconnections; does not wait for an answer.
        """

    def burst(self, request: BurstRequest) -> AsyncIterator[BurstStatus]:
        """Take a burst and yield its progress until it is done; leaving it early does not cancel it."""

    async def cancel_burst(self, burst: int) -> None:
        """Wait no longer for the images of a burst: it is saved with what has come."""

    async def invite(self) -> Invited:
        """Make a code by which one further machine with a camera becomes known to the leader."""

    async def invite_phone(self) -> PhoneInvited:
        """Serve the page by which the next phone becomes a camera; asked again, the present one."""

    async def end_burst(self, burst: int) -> None:
        """Let a recording, or a long burst, end now: it is saved with what was taken."""

    async def add_camera(self, spec: str, name: str | None = None) -> None:
        """Start a camera of the leader's machine; returns when its process runs, before it has joined."""

    async def add_simulated(self, cameras: int, scene: str = "studio") -> None:
        """Start so many further simulated cameras on the leader's machine."""

    async def remove_camera(self, name: str) -> None:
        """End a node of the leader's (`NodeStatus.on_leader`), or forget one that is lost."""

    async def detail(self, name: str) -> NodeDetail:
        """Ask a node for what is too much for the status: to be asked once or twice a second, not more."""

    async def match_cameras(self, source: str) -> list[ControlledCamera]:
        """Hold exposure, gain, white balance and focus of one camera, and set them on all others that can."""

    async def stop_rig(self) -> None:
        """End the leader's process and the cameras that are its children; bursts are saved as they are."""

"""Previews of one instant: small images of all cameras that show it."""

from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from capture_app.common import system
from capture_app.common.errors import NetworkError
from capture_app.protocol.status import Preview, RigStatus
from capture_app.rig.rig_link import LinkLost, RigLink
from capture_app.session.reading.decoding import decode_preview

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


APART_S = 0.05
"""Difference from which pictures are not called of one moment, in seconds."""
OLD_S, OLD_WHILE_SAVING_S = 1.0, 2.0
"""Age from which a picture is not live, in seconds; a node that sends frames gives one each 0.8 s."""


def old_from_s(status: RigStatus | None) -> float:
    """Return the age from which pictures are not live, in seconds."""
    is_saving = status is not None and status.burst is not None and not status.burst.done
    return OLD_WHILE_SAVING_S if is_saving else OLD_S


class InstantPreviews(Struct, frozen=True):
    """Previews of the cameras that show one instant of the rig; its leader time in ns."""

    instant_ns: int
    previews: dict[str, Preview]
    leader_ahead_ns: int | None = None
    """Leader time minus this machine's monotonic clock; None if unknown."""
    absent: dict[str, str] = {}
    """States of the other cameras by name, as `syncing`; one that is `ready` gave its preview too late."""

    def __repr__(self) -> str:
        seen = [f"{name} {preview.width}x{preview.height}" for name, preview in self.previews.items()]
        without = [f"without {name}: {state}" for name, state in self.absent.items()]
        return f"<{type(self).__name__} {', '.join(seen + without)}>"

    @property
    def spread_ns(self) -> int:
        """Time from the first to the last of their frames, in ns."""
        times_ns = [preview.leader_ns for preview in self.previews.values() if preview.leader_ns is not None]
        return max(times_ns) - min(times_ns)

    def age_ns(self) -> int | None:
        """Return the time since the instant in ns, too short by a message's time from the leader; or None."""
        ahead_ns = self.leader_ahead_ns
        return None if ahead_ns is None else system.monotonic_ns() + ahead_ns - self.instant_ns

    def bgr(self) -> "dict[str, NDArray[np.uint8]]":
        """Return the images by camera, BGR uint8 (height, width, 3), without undecodable ones."""
        images = {name: decode_preview(preview.jpeg) for name, preview in self.previews.items()}
        return {name: image for name, image in images.items() if image is not None}


class LeaderMoments:
    """The leader's moments by a clock of this machine, too late by a message's time from the leader."""

    def __init__(self) -> None:
        self.ahead_ns: int | None = None
        """Leader time minus this machine's clock; None if unknown."""

    def hear(self, leader_ns: int, here_ns: int) -> None:
        """Learn from a status of this leader time that came now."""
        # The status that took least time is the newest one by this clock.
        ahead_ns = leader_ns - here_ns
        self.ahead_ns = ahead_ns if self.ahead_ns is None else max(ahead_ns, self.ahead_ns)

    def here_ns(self, leader_ns: int | None, now_ns: int) -> int:
        """Return a moment by this machine's clock; now if it is unknown."""
        return now_ns if leader_ns is None or self.ahead_ns is None else leader_ns - self.ahead_ns


def collect(newest: dict[str, Preview], preview: Preview) -> InstantPreviews | None:
    """Store a preview as its camera's newest; return its instant's previews if it completes the instant."""
    newest[preview.camera] = preview
    if preview.instant_ns is None or not preview.completes:
        return None
    same = {name: other for name, other in newest.items() if other.instant_ns == preview.instant_ns}
    return InstantPreviews(preview.instant_ns, same)


class Gathering:
    """Previews that wait for the other cameras', so that all are shown together."""

    def __init__(self) -> None:
        self._newest: dict[str, Preview] = {}
        self._waiting: dict[str, Preview] = {}

    def add(self, preview: Preview) -> tuple[tuple[Preview, ...], InstantPreviews | None]:
        """Return the previews to show now, and all of one instant if it is complete.

        A preview without an instant, of a camera that is not synchronized, waits for none.
        """
        previews = collect(self._newest, preview)
        if preview.instant_ns is None:
            return (preview,), None
        is_second = preview.camera in self._waiting  # the last of its instant never came
        self._waiting[preview.camera] = preview
        if previews is None and not is_second:
            return (), None
        shown, self._waiting = tuple(self._waiting.values()), {}
        return shown, previews


async def instant_previews(
    link: RigLink, *, cameras: tuple[str, ...] | None, width: int, fps: float
) -> AsyncGenerator[InstantPreviews, None]:
    """Yield the previews of one instant after the other, up to `fps` a second; none during a burst.

    A slow reader skips instants. Cameras that are not synchronized are left out. Raises NetworkError if the
    connection to the leader is lost.
    """
    await link.want_previews(cameras=cameras, width=width, fps=fps)
    newest: dict[str, Preview] = {}
    states: dict[str, str] = {}
    moments = LeaderMoments()
    async with aclosing(link.updates()) as updates:
        async for update in updates:
            if isinstance(update, LinkLost):
                raise NetworkError(update.reason, hint="look for the leader: capture-app rig list")
            if isinstance(update, RigStatus):
                states = {node.name: node.state.value for node in update.cameras}
                moments.hear(update.now_ns, system.monotonic_ns())
            if isinstance(update, Preview) and (previews := collect(newest, update)) is not None:
                absent = {name: state for name, state in states.items() if name not in previews.previews}
                yield replace(previews, leader_ahead_ns=moments.ahead_ns, absent=absent)

"""What one camera owes to a burst, and how far it is."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field

from capture_app.node.transfer.incoming import Incoming, begun
from capture_app.node.wire.messages import CameraReport, Held
from capture_app.session.format.manifest import CameraRecord, MissingImage
from capture_app.session.writing.store import SessionWriter


@dataclass(slots=True)
class Share:
    """One camera's share of a burst; times in ns of the leader's clock."""

    camera: CameraRecord
    heard_ns: int
    streams: int = 0
    report: CameraReport | None = None
    instants: set[int] = field(default_factory=set)
    given_up: str = ""
    silent: bool = False
    """Given up because nothing was heard of it: it may still have its images."""
    incoming: Incoming | None = None
    # One write at a time: a node that sends again after a broken stream meets its own first try.
    writing: asyncio.Lock = field(default_factory=asyncio.Lock)

    def is_complete(self) -> bool:
        """Whether nothing is waited for."""
        return bool(self.given_up) or (self.report is not None and self.instants >= set(self.report.instants))

    def held(self, writer: SessionWriter) -> tuple[Held, ...]:
        """What is here of its images, whole or in part. Blocks on the disk."""
        name = self.camera.name
        images = [writer.image(name, instant) for instant in sorted(self.instants)]
        stored = (
            Held(instant=image.instant, sha256=image.sha256, bytes=image.bytes, stored=True)
            for image in images
            if image is not None
        )
        return (*stored, *begun(writer.folder, name))

    def missing(self, instants: int, lost: Mapping[tuple[str, int], MissingImage]) -> list[MissingImage]:
        """What has not come of that many instants, and why; `lost` are reasons from before."""
        name = self.camera.name
        told = {gap.instant: gap for (camera, _), gap in lost.items() if camera == name}
        told |= {gap.instant: gap for gap in self.report.missing} if self.report else {}
        return [
            told.get(instant)
            or MissingImage(camera=name, instant=instant, reason=self.given_up or "it never came")
            for instant in range(instants)
            if instant not in self.instants
        ]

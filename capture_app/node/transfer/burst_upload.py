"""What a node has of a burst on its way to the leader: frames, encoded images, a folder in the spool."""

import hashlib
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field

from msgspec.structs import replace

from capture_app.cameras.base import CapturedFrame
from capture_app.node.transfer.spool import SpooledBurst
from capture_app.node.wire.messages import CameraReport, ImageUpload
from capture_app.session.format.manifest import MissingImage
from capture_app.sync.rig.frame_picks import Pick


@dataclass(slots=True)
class BurstUpload:
    """A burst's frames on their way to the leader: picked, then encoded, then confirmed."""

    report: CameraReport
    frames: deque[Pick[CapturedFrame]]
    images: deque[ImageUpload] = field(default_factory=deque)
    """Ready to send as often as it takes."""
    in_memory: dict[int, bytes] = field(default_factory=dict)
    """By instant, the bytes of those images that are not in the spool."""
    confirmed: set[int] = field(default_factory=set)
    """Instants that the leader has."""
    spooled: SpooledBurst | None = None
    spooling: bool = True
    """Whether the spool is to be used; False once it was full."""

    def load(self, image: ImageUpload) -> bytes | None:
        """An image's bytes; None where the spool does not have them as they were."""
        if image.record.instant in self.in_memory:
            return self.in_memory[image.record.instant]
        assert self.spooled is not None
        try:
            data = self.spooled.image_file(image).read_bytes()
        except OSError:
            return None
        record = image.record
        whole = len(data) == record.bytes + image.truth_bytes
        return data if whole and hashlib.sha256(data[: record.bytes]).hexdigest() == record.sha256 else None

    def confirm(self, image: ImageUpload) -> None:
        """Let go of an image that the leader has. Blocks on the disk."""
        self.confirmed.add(image.record.instant)
        self.in_memory.pop(image.record.instant, None)
        if self.spooled is not None:
            self.spooled.remove_image(image)

    def lost_instants(self) -> list[int]:
        """Those that were announced and are neither here nor with the leader."""
        here = {image.record.instant for image in self.images} | {frame.instant for frame in self.frames}
        return sorted(set(self.report.instants) - here - self.confirmed)

    def report_lost(self, instants: Collection[int], reason: str) -> None:
        """Move announced images that will not come to those that are missing."""
        name = self.report.camera.name
        gone = tuple(MissingImage(camera=name, instant=instant, reason=reason) for instant in instants)
        left = tuple(instant for instant in self.report.instants if instant not in instants)
        self.report = replace(self.report, instants=left, missing=(*self.report.missing, *gone))

"""What a node has of a burst on its way to the leader: frames, developed images, a folder in the spool."""

import hashlib
from collections import deque
from dataclasses import dataclass, field

from capture_app.cameras.base import CapturedFrame
from capture_app.node.transfer.spool import SpooledBurst
from capture_app.node.wire.messages import CameraReport, ImageUpload
from capture_app.sync.rig.frame_picks import Pick


@dataclass(slots=True)
class Developed:
    """An image ready to send as often as it takes: its bytes in memory, or in the spool alone."""

    upload: ImageUpload
    data: bytes | None


@dataclass(slots=True)
class BurstWork:
    """A burst's frames on their way to the leader."""

    report: CameraReport
    picks: deque[Pick[CapturedFrame]]
    images: deque[Developed] = field(default_factory=deque)
    confirmed: set[int] = field(default_factory=set)
    """Instants that the leader has."""
    spooled: SpooledBurst | None = None
    spooling: bool = True
    """Whether the spool is to be used; False once it was full."""

    def load(self, image: Developed) -> bytes | None:
        """An image's bytes; None where the spool does not have them as they were."""
        if image.data is not None:
            return image.data
        assert self.spooled is not None
        try:
            data = self.spooled.file(image.upload).read_bytes()
        except OSError:
            return None
        record = image.upload.record
        whole = len(data) == record.bytes + image.upload.truth_bytes
        return data if whole and hashlib.sha256(data[: record.bytes]).hexdigest() == record.sha256 else None

"""A burst whose frames are sent as they are picked: what is known of it so far."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from msgspec.structs import replace

from capture_app.cameras.base import CapturedFrame
from capture_app.node.wire.messages import CameraReport
from capture_app.session.format.burst_plan import MissingRun
from capture_app.session.format.manifest import MissingImage
from capture_app.sync.rig.frame_picks import RING_BYTES, Pick

TOO_SLOW = "the node could not save its frames as fast as they came"


@dataclass(slots=True)
class PickedStream:
    """Which instants of one camera are decided, and which of them are missing."""

    video: bool = False
    """The frames go into a video, which has no ground truth but their times."""
    most_bytes: int = RING_BYTES
    """The most memory that frames may take that are not on a disk yet: the camera goes on."""
    over: int = 0
    """So many instants are decided."""
    ended: bool = False
    """Nothing more is picked."""
    runs: list[MissingRun] = field(default_factory=list)
    kept: bool = False
    """Whether the spool has what is known at the end."""
    waiting_bytes: int = 0
    """What the frames take that are not encoded yet."""

    def add(
        self,
        frames: Iterable[Pick[CapturedFrame]],
        missing: Iterable[MissingImage],
        *,
        over: int,
        held_bytes: int,
    ) -> list[Pick[CapturedFrame]]:
        """Note what was picked, and return the frames that there is memory for; others are missing.

        `held_bytes` is what images take that are encoded, and are not on a disk yet.
        """
        self.over = max(self.over, over)
        for gap in missing:
            self.note_missing(gap.instant, gap.reason, dropped=gap.dropped)
        kept = []
        for frame in frames:
            size = frame.frame.picture.held_bytes
            if held_bytes + self.waiting_bytes + size > self.most_bytes:
                self.note_missing(frame.instant, TOO_SLOW)
                continue
            self.waiting_bytes += size
            kept.append(frame)
        return kept

    def note_encoded(self, frame: Pick[CapturedFrame]) -> None:
        """A frame waits no longer."""
        self.waiting_bytes -= frame.frame.picture.held_bytes

    def note_missing(self, instant: int, reason: str, *, dropped: bool = False) -> None:
        """An instant has no frame."""
        last = self.runs[-1] if self.runs else None
        follows = last is not None and last.first + last.count == instant
        if last is not None and follows and (last.reason, last.dropped) == (reason, dropped):
            self.runs[-1] = replace(last, count=last.count + 1)
        else:
            self.runs.append(MissingRun(first=instant, count=1, reason=reason, dropped=dropped))

    def report(self, report: CameraReport, waiting: Iterable[int]) -> CameraReport:
        """A node's report with what there is to tell now; `waiting` are instants whose images are here."""
        told = replace(report, instants=tuple(waiting), picking=not self.ended, missing=())
        return replace(told, picked=self.over, missing_runs=tuple(self.runs)) if self.ended else told

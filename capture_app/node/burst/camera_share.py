"""What one camera owes to a burst: what it has told, the image that comes in, how long it is waited for."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from msgspec.structs import replace

from capture_app.common.timeouts import (
    CAMERA_DISCONNECTED_AGAIN_NS,
    CAMERA_DISCONNECTED_NS,
    CAMERA_STALLED_NS,
)
from capture_app.node.burst.intake import partial_receipts
from capture_app.node.burst.plans import InstantChoice
from capture_app.protocol.messages import ImageReceipt
from capture_app.protocol.status import CameraTransfer
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import MissingImage
from capture_app.session.writing.instant_set import InstantSet
from capture_app.session.writing.session_writer import SessionWriter

ADVANCE_BYTES = 1 << 18
"""How much of an image counts as something: a slow link brings less than a whole one in all that time."""


@dataclass(slots=True)
class CameraShare:
    """What one camera owes to a burst, and how far it is; times in ns of the leader's clock."""

    plan: CameraPlan
    """What it has told, with the instants' numbers as they were ordered."""
    heard_ns: int
    short_timeout: bool = False
    """It brought nothing of the burst before, without a word: it is waited for less."""
    instants: InstantSet = field(default_factory=InstantSet)
    """Whose images are in the session, with their numbers there."""
    streams: int = 0
    advanced_ns: int = 0
    """When it last brought something, or had to wait for others."""
    counted_bytes: int = 0
    """How many bytes of its images are counted as an advance."""
    given_up: str = ""
    silent: bool = False
    """Given up because nothing was heard of it: it may still have its images."""

    def __post_init__(self) -> None:
        """Count as advanced from when it is waited for."""
        self.advanced_ns = max(self.advanced_ns, self.heard_ns)

    @property
    def name(self) -> str:
        """The camera's."""
        return self.plan.camera.name

    @property
    def told(self) -> CameraPlan | None:
        """The plan, once the camera has told it."""
        return self.plan if self.plan.reported else None

    def is_complete(self, choice: InstantChoice) -> bool:
        """Whether nothing is waited for."""
        plan = self.plan
        if self.given_up:
            return True
        if not plan.reported or not choice.is_committed or plan.picking:
            return False
        if plan.picked is not None:
            decided = min(plan.picked, len(choice.chosen or ()))
            gone = sum(max(0, min(run.first + run.count, decided) - run.first) for run in plan.missing_runs)
            return len(self.instants) >= decided - gone
        return self.instants >= choice.numbers(plan.instants)

    def transfer(self, instants: int) -> CameraTransfer:
        """How much of so many instants it has brought."""
        return CameraTransfer(
            camera=self.name, received=len(self.instants), expected=instants, problem=self.given_up
        )

    def why_silent(self, lost: Mapping[str, str], now_ns: int) -> str:
        """Why not to wait for it any longer, empty where there is no reason; `lost` are reasons by name."""
        silent_ns = now_ns - self.heard_ns
        if self.short_timeout:
            gone_ns, stalled_ns = CAMERA_DISCONNECTED_AGAIN_NS, CAMERA_DISCONNECTED_NS
        else:
            gone_ns, stalled_ns = CAMERA_DISCONNECTED_NS, CAMERA_STALLED_NS
        if silent_ns >= gone_ns and (not self.streams or self.name in lost):
            return lost.get(self.name, "it sent nothing")
        if self.streams and self.name not in lost and self.plan.picking:
            # The next instant may be hours away.
            return ""
        # Words without images do not count, nor images that trickle: they could go on for ever.
        stalled = now_ns - self.advanced_ns >= stalled_ns
        return f"it sent nothing for {stalled_ns // 10**9} s" if stalled else ""

    def note_heard(self, now_ns: int, *, advanced: bool = False) -> None:
        """The camera has been heard of; `advanced` where it brought something, or waits for others."""
        self.heard_ns = max(self.heard_ns, now_ns)
        if advanced:
            self.advanced_ns = max(self.advanced_ns, now_ns)

    def note_arrivals(self, arrived_bytes: int, now_ns: int) -> None:
        """Count what has come of images, where it is enough more than the last time."""
        if arrived_bytes - self.counted_bytes >= ADVANCE_BYTES:
            self.counted_bytes = arrived_bytes
            self.note_heard(now_ns, advanced=True)

    def note_report(self, told: CameraPlan, *, is_of_earlier_run: bool) -> None:
        """Take what the camera tells for its plan, and wait for it.

        What an earlier run of the leader knew the camera to be stays: only what is to come is told anew.
        """
        if is_of_earlier_run and self.plan.reported:
            before = self.plan
            told = replace(
                told, camera=before.camera, calibration=before.calibration, true_clock=before.true_clock
            )
        self.plan = replace(told, reported=True)
        self.given_up, self.silent = "", False

    def receipts(self, writer: SessionWriter, choice: InstantChoice) -> tuple[ImageReceipt, ...]:
        """What is here of its images, whole or in part, numbered as ordered. Blocks on the disk.

        Of images that are sent as they come only those count that the camera says it still has.
        """
        chosen, plan = choice.chosen or (), self.plan
        sent_as_they_come = plan.picking or plan.picked is not None
        asked = self.instants & {*plan.instants} if sent_as_they_come else self.instants
        images = [writer.image(self.name, instant) for instant in sorted(asked)]
        stored = (
            ImageReceipt(instant=image.instant, sha256=image.sha256, bytes=image.bytes, stored=True)
            for image in images
            if image is not None
        )
        return tuple(
            replace(receipt, instant=chosen[receipt.instant])
            for receipt in (*stored, *partial_receipts(writer.folder, self.name))
            if receipt.instant < len(chosen)
        )

    def missing_images(
        self, choice: InstantChoice, lost: Mapping[tuple[str, int], MissingImage]
    ) -> list[MissingImage]:
        """What has not come of the session's instants, and why; `lost` are reasons from before."""
        name, chosen = self.name, choice.chosen or ()
        told = {gap.instant: gap for (camera, _), gap in lost.items() if camera == name}
        for run in self.plan.missing_runs:
            for instant in range(run.first, min(run.first + run.count, len(chosen))):
                told[instant] = MissingImage(
                    camera=name, instant=instant, reason=run.reason, dropped=run.dropped
                )
        for gap in self.plan.missing:
            if gap.instant in chosen:
                number = chosen.index(gap.instant)
                told[number] = replace(gap, instant=number)
        return [
            told.get(number)
            or MissingImage(camera=name, instant=number, reason=self.given_up or "it never came")
            for number in range(len(chosen))
            if number not in self.instants
        ]

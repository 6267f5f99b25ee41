"""One camera's part of a burst: its report, its images received so far, and the timeouts for it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from msgspec.structs import replace

from capture_app.common.bounds import CENTURY_NS, MAX_COUNT
from capture_app.common.timeouts import (
    CAMERA_DISCONNECTED_AGAIN_NS,
    CAMERA_DISCONNECTED_NS,
    CAMERA_STALLED_NS,
    MIN_UPLOAD_BYTES_PER_S,
)
from capture_app.node.burst.plans import InstantChoice
from capture_app.protocol.messages import ImageReceipt
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import (
    MAX_MOVES,
    MAX_WIDENED,
    CameraRecord,
    MissingImage,
    WidenedTimes,
)
from capture_app.session.writing.instant_set import InstantSet
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import RING_NS


@dataclass(slots=True)
class CameraDelivery:
    """One camera's part of a burst and its progress; times in ns of the leader's clock."""

    plan: CameraPlan
    """The camera's report, with the instants numbered as ordered."""
    heard_ns: int
    short_timeout: bool = False
    """The camera was silent in the previous burst, so its timeouts are shorter."""
    instants: InstantSet = field(default_factory=InstantSet)
    """Instants whose images are in the session, by their numbers there."""
    streams: int = 0
    since_ns: int = 0
    """When the leader began to wait for it, plus the time that the image bytes received since may take."""
    counted_bytes: int = 0
    """Number of this burst's image bytes that were counted already."""
    given_up: str = ""
    silent: bool = False
    """Given up because it was silent: it may still have its images."""

    def __post_init__(self) -> None:
        """Begin to wait when the camera is first expected."""
        self.since_ns = max(self.since_ns, self.heard_ns)

    @property
    def title(self) -> str:
        """What people call its camera."""
        return self.plan.camera.facts.called(self.name)

    @property
    def name(self) -> str:
        """Name of the camera."""
        return self.plan.camera.name

    @property
    def reported_plan(self) -> CameraPlan | None:
        """The camera's plan once it has reported it, else None."""
        return self.plan if self.plan.reported else None

    def has_left_off(self, frames: int) -> bool:
        """Return whether its node was restarted before the last of `frames` streamed instants.

        It has reported what the earlier run of the node left, and takes no frames at present.
        """
        is_over = self.plan.reported and not self.plan.picking and not self.given_up
        return is_over and (self.plan.picked or 0) < frames

    def is_complete(self, choice: InstantChoice) -> bool:
        """Return whether nothing of this camera is awaited."""
        plan = self.plan
        if self.given_up:
            return True
        if not plan.reported or not choice.committed.is_set() or plan.picking:
            return False
        if plan.picked is not None:
            decided = range(min(plan.picked, len(choice.chosen or ())))
            missing = sum(len(decided[run.first : run.first + run.count]) for run in plan.missing_runs)
            # A count alone would not wait for an image in place of one that was reported missing, and came.
            if len(self.instants) < len(decided) - missing:
                return False
        return self.instants >= choice.numbers(plan.instants)

    def why_silent(self, lost: Mapping[str, str], now_ns: int, ends_ns: int) -> str:
        """Return why not to wait for it any longer, empty for no reason.

        `lost` are reasons by name; `ends_ns` is the burst's last instant.
        """
        disconnected_ns, stalled_ns = (
            (CAMERA_DISCONNECTED_AGAIN_NS, CAMERA_DISCONNECTED_NS)
            if self.short_timeout
            else (CAMERA_DISCONNECTED_NS, CAMERA_STALLED_NS)
        )
        if now_ns - self.heard_ns >= disconnected_ns and (not self.streams or self.name in lost):
            return lost.get(self.name, "it sent nothing")
        # The next instant of a streamed burst may be hours away, but not after the last.
        is_capturing = self.plan.picking and self.streams and self.name not in lost
        since_ns = max(self.since_ns, ends_ns) if is_capturing else self.since_ns
        # Messages without images, or images that trickle, do not count: they could go on forever.
        return f"it sent nothing for {stalled_ns // 10**9} s" if now_ns - since_ns >= stalled_ns else ""

    def note_heard(self, now_ns: int) -> None:
        """Record a message of the camera."""
        self.heard_ns = max(self.heard_ns, now_ns)

    def note_arrivals(self, image_bytes: int, now_ns: int) -> None:
        """Count bytes of the camera's images, of any burst, as progress, for as long as they may take."""
        if image_bytes:
            self.note_heard(now_ns)
            may_take_ns = image_bytes * 1_000_000_000 // MIN_UPLOAD_BYTES_PER_S
            self.since_ns = max(self.since_ns, min(now_ns, self.since_ns + may_take_ns))

    def note_report(self, plan: CameraPlan, now_ns: int) -> None:
        """Store the camera's report as its plan, and wait for its images.

        The camera's facts and clock stay as first reported: its images were timed by these, and a node that
        was started again has others. Times that were found to be wrong since are added. Only a first report
        counts as progress: it could be repeated forever.
        """
        self.note_heard(now_ns)
        if self.plan.reported:
            known = self.plan.camera
            found = *known.widened, *plan.camera.widened, *_another_clock(known, plan.camera)
            widened = tuple(dict.fromkeys(found))
            moves = tuple(dict.fromkeys((*known.moves, *plan.camera.moves)))[:MAX_MOVES]
            plan = replace(
                plan,
                camera=replace(known, widened=widened[:MAX_WIDENED], moves=moves),
                calibration=self.plan.calibration,
                true_clock=self.plan.true_clock,
            )
        else:
            self.since_ns = max(self.since_ns, now_ns)
        self.plan = replace(plan, reported=True)
        self.given_up, self.silent = "", False

    def note_damaged(self, instant: int, reason: str) -> None:
        """Record an image that arrived damaged as missing, by its instant as ordered."""
        gap = MissingImage(camera=self.name, instant=instant, reason=reason)
        self.plan = replace(
            self.plan,
            instants=tuple(other for other in self.plan.instants if other != instant),
            missing=(*(other for other in self.plan.missing if other.instant != instant), gap),
        )

    def receipts(
        self, writer: SessionWriter, choice: InstantChoice, *, reported_only: bool
    ) -> tuple[ImageReceipt, ...]:
        """Return receipts of its stored images, numbered as ordered. Blocks on the disk.

        `reported_only`: of a streamed burst, which may have very many images, only of those that the camera
        reports it still has.
        """
        chosen = choice.chosen or ()
        asked = self.instants & {*self.plan.instants} if reported_only else self.instants
        images = [writer.image(self.name, instant) for instant in sorted(asked) if instant < len(chosen)]
        return tuple(
            ImageReceipt(instant=chosen[image.instant], sha256=image.sha256)
            for image in images
            if image is not None
        )

    def missing_images(
        self, choice: InstantChoice, lost: Mapping[tuple[str, int], MissingImage]
    ) -> list[MissingImage]:
        """Return the session's instants without an image, and why; `lost` are reasons from before."""
        name, chosen = self.name, choice.chosen or ()
        reasons = {gap.instant: gap for (camera, _), gap in lost.items() if camera == name}
        reasons |= {
            instant: MissingImage(camera=name, instant=instant, reason=run.reason, dropped=run.dropped)
            for run in self.plan.missing_runs
            for instant in range(run.first, min(run.first + run.count, len(chosen)))
        }
        for gap in self.plan.missing:
            if gap.instant in chosen:
                number = chosen.index(gap.instant)
                reasons[number] = replace(gap, instant=number)
        return [
            reasons.get(number)
            or MissingImage(camera=name, instant=number, reason=self.given_up or "it never came")
            for number in range(len(chosen))
            if number not in self.instants
        ]


def _another_clock(known: CameraRecord, newer: CameraRecord) -> Iterator[WidenedTimes]:
    """Yield by how much a later run's clock record differs: an interval of no length, at its start.

    No time is wrong for it; it says which images the known record does not convert.
    """
    before, clock = known.clock, newer.clock
    if before is not None and clock is not None and before != clock:
        at_ns = max(-CENTURY_NS, clock.epoch_local_ns - 2 * RING_NS)
        apart_ns = abs(clock.leader_from_local(at_ns) - before.leader_from_local(at_ns))
        yield WidenedTimes(
            from_local_ns=at_ns,
            until_local_ns=at_ns,
            uncertainty_ns=min(MAX_COUNT, apart_ns + clock.uncertainty_ns),
            hard_bound_ns=min(MAX_COUNT, apart_ns + clock.hard_bound_ns),
            reason="its node was started again",
        )

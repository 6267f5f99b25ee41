"""Plan of a burst: the ordered instants, the chosen ones, and the record on disk to finish it from."""

import asyncio
from collections.abc import Collection, Mapping, Sequence

from msgspec.structs import replace

from capture_app.common.camera_facts import SIMULATED, CameraFacts
from capture_app.common.errors import BadInputError, TryAgainError
from capture_app.common.text import count, megabytes
from capture_app.net.channel import MAX_PAYLOAD_BYTES
from capture_app.protocol.messages import ImageUpload
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan, InstantRange
from capture_app.session.format.calibration_judge import check_lens
from capture_app.session.format.manifest import (
    AbsentCamera,
    BurstRecord,
    MissingImage,
    SkippedFrame,
    SkippedInstant,
)
from capture_app.session.reading.verdict import skipped_text
from capture_app.sync.rig.frame_selection import Burst

MAX_TRUTH_BYTES, MAX_TRUTH_BYTES_PER_PIXEL = 16 << 20, 8
"""More than the uncompressed depth, object and mover of a pixel."""
MAX_EXTRA_BYTES, MAX_BYTES_PER_PIXEL = 1 << 20, 8
"""More than an image file's header and thumbnail, and than a pixel of three uncompressed 16-bit values."""


def choose_instants(
    ordered: int, frames: int, cameras: Collection[CameraPlan | None]
) -> tuple[int, ...] | None:
    """Choose `frames` of the ordered instants; return None while more reports are needed.

    `cameras` are the awaited cameras, None for one without a report. If fewer instants are complete than
    requested, those with the most cameras are added. Among equals, a camera that lacks more than half of the
    ordered instants costs the others none; then the earliest come first.
    """
    reports = [camera for camera in cameras if camera is not None]
    if len(reports) < len(cameras):
        return None
    there = [frozenset(camera.instants) for camera in reports]
    missing = {gap.instant for camera in reports for gap in camera.missing}
    possible = (instant for instant in range(ordered) if instant not in missing)
    complete = [instant for instant in possible if all(instant in instants for instants in there)][:frames]
    decided = complete[-1] + 1 if len(complete) == frames else ordered
    if {*range(decided)} - missing - {*complete}:
        return None
    if len(complete) < frames:
        others = (instant for instant in range(ordered) if instant not in complete)
        steady = [instants for instants in there if 2 * len(instants) >= ordered]

        def cameras_at(n: int) -> tuple[int, int]:
            return sum(n in instants for instants in there), sum(n in instants for instants in steady)

        complete += sorted(others, key=cameras_at, reverse=True)[: frames - len(complete)]
    return tuple(sorted(complete))


def settled(plan: CameraPlan, ordered: int) -> CameraPlan:
    """Return a report with those of the first `ordered` instants that it leaves out as missing."""
    known = {*plan.instants, *(gap.instant for gap in plan.missing)}
    gaps = (
        MissingImage(camera=plan.camera.name, instant=instant, reason="its node did not report it")
        for instant in range(ordered)
        if instant not in known
    )
    return replace(plan, missing=(*plan.missing, *gaps))


Reports = Mapping[str, CameraPlan | None]
"""Each camera's report, None for a camera without one, by name."""
Absent = Mapping[str, AbsentCamera]
"""Cameras of the rig that take no part, and why."""


class InstantChoice:
    """Mapping between a session's instants, numbered from 0, and the ordered ones as nodes number them."""

    def __init__(self, burst: Burst, chosen: tuple[int, ...] | None = None) -> None:
        """`chosen` are the instants of a resumed burst; a burst without spare instants has all of them."""
        self._burst = burst
        self.chosen: Sequence[int] | None = chosen if burst.spare else range(burst.frames)
        """Their numbers as ordered; None while the burst is not committed."""
        self.committed = asyncio.Event()
        """Set when the instants are decided; they never change after that."""
        if self.chosen is not None:
            self.committed.set()

    def commit(self, chosen: Sequence[int]) -> None:
        """Commit the burst to these instants, by their numbers as ordered."""
        self.chosen = chosen
        self.committed.set()

    @property
    def requested(self) -> tuple[int, ...] | None:
        """The instants that nodes are to send; None for all, or while undecided."""
        return tuple(self.chosen) if self._burst.spare and self.chosen is not None else None

    def end(self, burst: Burst) -> None:
        """Commit to the instants of `burst`, a streamed burst that ends earlier than ordered."""
        self._burst, self.chosen = burst, range(burst.frames)

    def numbers(self, ordered: Collection[int]) -> set[int]:
        """Return the session's numbers of the given ordered instants that it contains."""
        if not self._burst.spare:
            return {instant for instant in ordered if instant < self._burst.frames}
        reports = frozenset(ordered)
        return {number for number, instant in enumerate(self.chosen or ()) if instant in reports}

    def number(self, instant: int) -> int:
        """Return the session's number of an ordered instant.

        Raises BadInputError for an instant that was not chosen, TryAgainError while that is undecided.
        """
        if not 0 <= instant < len(self._burst.instants_ns):
            raise BadInputError(f"burst {self._burst.number} has no instant {instant}")
        if self.chosen is None:
            raise TryAgainError(f"the instants of burst {self._burst.number} are not decided yet")
        if instant not in self.chosen:
            raise BadInputError(f"instant {instant} was not chosen for burst {self._burst.number}")
        return self.chosen.index(instant)

    def skipped(self, reports: Reports) -> tuple[SkippedInstant, ...]:
        """Return the instants that later ones have replaced, and why."""
        if not self._burst.spare:
            return ()
        chosen = self.chosen or (0,)
        gaps = [gap for _, report in sorted(reports.items()) if report is not None for gap in report.missing]
        return tuple(
            SkippedInstant(
                leader_ns=self._burst.instants_ns[instant],
                missing=tuple(
                    SkippedFrame(camera=gap.camera, reason=gap.reason, dropped=gap.dropped)
                    for gap in gaps
                    if gap.instant == instant
                ),
            )
            for instant in sorted({*range(chosen[-1])} - {*chosen})
        )

    def record(self, reports: Reports, absent: Absent) -> BurstRecord:
        """Return the burst's record for the manifest."""
        burst = self._burst
        return BurstRecord(
            instants_ns=tuple(burst.instants_ns[instant] for instant in self.chosen or ()),
            period_ns=burst.period_ns,
            requested_ns=burst.requested_ns,
            skipped=self.skipped(reports),
            absent=tuple(camera for _, camera in sorted(absent.items())),
        )


def check_report(plan: CameraPlan, burst: Burst, latest: int) -> None:
    """Check that a camera's report is about its own images of this burst.

    `latest` is the number of instants that can have passed. Raises BadInputError.
    """
    name, runs = plan.camera.name, plan.missing_runs
    instants = [*plan.instants, *(gap.instant for gap in plan.missing)]
    last = max(instants, default=-1)
    run_ends = [0, *(run.first + run.count for run in runs)]
    decided = max(run_ends[-1], plan.picked or 0)
    is_streamed = plan.picking or plan.picked is not None or bool(runs)
    problems = {
        "it reports missing images of another camera": any(gap.camera != name for gap in plan.missing),
        "it lists an instant twice": len(instants) > len({*instants}),
        f"the burst has no instant {last}": last >= len(burst.instants_ns),
        "it streams a burst that is not streamed": is_streamed and not burst.streamed,
        f"it reports {decided} instants, of which {latest} have passed": decided > latest,
        "its missing instants are not in order": any(
            run.first < end for run, end in zip(runs, run_ends, strict=False)
        ),
    }
    if reasons := [problem for problem, is_so in problems.items() if is_so]:
        raise BadInputError(f"{name} sent an invalid report of burst {burst.number}: {reasons[0]}")
    if plan.calibration is not None:
        check_lens(f"the calibration of {name}", plan.calibration)


def size_problem(upload: ImageUpload, facts: CameraFacts) -> BadInputError | None:
    """Return the error of more bytes than a camera's pixels, or their ground truth, can have; else None."""
    pixels = facts.width * facts.height
    if upload.record.bytes > min(MAX_PAYLOAD_BYTES, MAX_EXTRA_BYTES + pixels * MAX_BYTES_PER_PIXEL):
        return BadInputError(
            f"{upload.record.camera} sent an image of {megabytes(upload.record.bytes)}, too many for"
            f" {facts.width}x{facts.height} pixels",
            hint="check that camera's driver, and update that machine",
        )
    truth_pixels = pixels if facts.kind == SIMULATED else 0
    if upload.truth_bytes <= min(MAX_TRUTH_BYTES, truth_pixels * MAX_TRUTH_BYTES_PER_PIXEL):
        return None
    return BadInputError(
        f"{upload.record.camera} sent an image with {upload.truth_bytes} bytes of ground truth",
        hint="only simulated cameras have some, of a few bytes per pixel: update that machine",
    )


def check_machine(plan: BurstPlan, camera: str, pin: str) -> None:
    """Raise BadInputError if the camera's part belongs to another machine; an empty pin always passes."""
    if pin and plan.pins.get(camera, pin) != pin:
        raise BadInputError(
            f"{camera} of {plan.name} is another machine's camera",
            hint="only the machine that took part in the burst can send its images",
        )


def burst_record(burst: Burst, absent: Absent | None = None) -> BurstRecord:
    """Return the record of a burst as ordered, without its instants if frames are streamed."""
    return BurstRecord(
        instants_ns=() if burst.streamed else tuple(burst.instants_ns),
        period_ns=burst.period_ns,
        requested_ns=burst.requested_ns,
        absent=tuple(camera for _, camera in sorted((absent or {}).items())),
    )


def instant_range(burst: Burst) -> InstantRange | None:
    """Return the instants of a streamed burst as a range; None for any other."""
    if not burst.streamed:
        return None
    first_ns, count = burst.instants_ns[0], len(burst.instants_ns)
    step_ns = burst.instants_ns[1] - first_ns if count > 1 else burst.period_ns
    return InstantRange(first_ns=first_ns, step_ns=step_ns, count=count, video=burst.video)


def burst_of(plan: BurstPlan) -> Burst:
    """Return the burst that a plan describes."""
    instants_ns, requested_ns = plan.instants_ns, plan.burst.requested_ns
    return Burst(
        plan.number,
        instants_ns,
        plan.burst.period_ns,
        instants_ns[0] if requested_ns is None else requested_ns,
        tuple(camera.camera.name for camera in plan.cameras),
        plan.spare,
        streamed=plan.streamed is not None,
        video=plan.streamed is not None and plan.streamed.video,
    )


def result_text(burst: BurstRecord, missing: Sequence[MissingImage], titles: Mapping[str, str]) -> str:
    """Return one line about missing images, skipped instants and those not taken; empty for none.

    `titles` is what people call each camera.
    """
    cameras = {
        why: sorted({titles[gap.camera] for gap in missing if gap.reason == why})
        for why in sorted({gap.reason for gap in missing})
    }
    reasons = "; ".join(f"{', '.join(names)}: {why}" for why, names in cameras.items())
    text = f"{count(len(missing), 'image')} missing ({reasons})" if missing else ""
    return "; ".join(filter(None, (burst.shortfall, text, skipped_text(burst.skipped, titles))))

"""One burst on its leader: collects reports and images, and writes a session even if some are missing."""

import asyncio
import dataclasses
import functools
from bisect import bisect_right
from collections import Counter
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from msgspec.structs import replace

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.errors import (
    BadInputError,
    DamagedImageError,
    DiskError,
    DiskFullError,
    SimulshotError,
    TryAgainError,
)
from capture_app.common.tasks import Background, has_come
from capture_app.common.text import count
from capture_app.common.timeouts import (
    AFTER_LAST_INSTANT_NS,
    ALL_DISCONNECTED_NS,
    CAMERA_DISCONNECTED_NS,
)
from capture_app.node.burst.camera_delivery import CameraDelivery
from capture_app.node.burst.intake import Intake, on_disk
from capture_app.node.burst.plans import (
    Absent,
    InstantChoice,
    burst_of,
    burst_record,
    check_machine,
    check_report,
    choose_instants,
    instant_range,
    result_text,
    settled,
    size_problem,
)
from capture_app.protocol.messages import CameraReport, ImageBatch, ImageUpload, ReportAck
from capture_app.protocol.status import BurstStatus, CameraTransfer
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import (
    MANIFEST,
    CameraRecord,
    MissingImage,
    check_image_path,
    image_path,
)
from capture_app.session.format.marks import Mark
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import MAX_STREAMED_FRAMES, Burst, is_open_ended

SAID_AFTER_S = 1.0
"""A wait for the disk or for cameras that takes longer is reported."""


SAME_CLOCK_NS = 5_000_000_000
"""Maximum change of the wall clock against the leader's clock, while that is the same: much less than a
computer takes to start again."""
MARK_MARGIN_NS = 1_000_000_000
"""Marks so long before the first instant or after the last belong to the take."""
Lost = dict[tuple[str, int], MissingImage]
"""Images that an earlier run of the leader missed or lost, with the reason, by camera and instant."""


class BurstSession:
    """Collector of one burst into a session, finished when every camera has delivered or is given up."""

    def __init__(
        self,
        burst: Burst,
        deliveries: Iterable[CameraDelivery],
        writer: SessionWriter,
        disk: ThreadPoolExecutor,
        *,
        lost: Lost | None = None,
        absent: Absent | None = None,
    ) -> None:
        """Begin with these cameras, or resume an earlier run, whose missing images are in `lost`.

        `absent` are the cameras of the rig that take no part, and why.
        """
        self.burst, self._absent = burst, absent or {}
        self.finished = asyncio.Event()
        self.session: Path | None = None
        self.message = self.trouble = ""
        """Trouble: why the leader's disk accepts no images at present; nodes keep them and ask again."""
        self.failure: SimulshotError | None = None
        """Error that kept the session from being written."""
        self.order_end: Callable[[], int] | None = None
        """Order the cameras to end a streamed burst now, and return the number of instants until then."""
        self._broken_off: int | None = None
        """Number of instants until an error of the disk, or the leader's end, ended it.

        Its cameras have frames of all of them.
        """
        self.is_closing = False
        """Whether nothing more is awaited, though all cameras of a streamed burst may come back."""
        self._writer, self._disk, self._lost = writer, disk, lost
        self._is_of_this_run = lost is None
        self._now_ns = 0
        """Leader time of the last check for silent cameras."""
        self._deliveries = {delivery.name: delivery for delivery in deliveries}
        self._began_ns = min((delivery.heard_ns for delivery in self._deliveries.values()), default=0)
        self._choice = InstantChoice(burst, None if writer.plan is None else writer.plan.chosen)
        self._committing = asyncio.Lock()
        self._plan: BurstPlan | None = writer.plan
        """The plan that is to be on disk."""
        self._writing_plan = asyncio.Lock()
        self._intake = Intake(writer, disk, burst, self.finished, self._deliveries)
        self._background = Background()

    @classmethod
    def begin(
        cls,
        burst: Burst,
        cameras: Mapping[str, CameraFacts],
        writer: SessionWriter,
        disk: ThreadPoolExecutor,
        *,
        delays_ns: Mapping[str, int] | None = None,
        short_timeouts: Collection[str] = (),
        absent: Absent | None = None,
    ) -> "BurstSession":
        """Begin a burst that has been ordered, of those `cameras`, with their planned delays.

        Cameras in `short_timeouts` are awaited for a shorter time. `absent` is as in `BurstSession`.
        """
        heard_ns = burst.instants_ns[0 if burst.streamed else -1] + AFTER_LAST_INSTANT_NS
        deliveries = [
            CameraDelivery(
                CameraPlan(
                    camera=CameraRecord(name=name, facts=facts, delay_ns=(delays_ns or {}).get(name, 0))
                ),
                heard_ns,
                short_timeout=name in short_timeouts,
            )
            for name, facts in cameras.items()
            if name in burst.clients
        ]
        return cls(burst, deliveries, writer, disk, absent=absent)

    @classmethod
    def resume(
        cls,
        folder: Path,
        heard_ns: int,
        disk: ThreadPoolExecutor,
        *,
        is_of_this_run: bool = False,
        is_closing: bool = False,
    ) -> "BurstSession":
        """Resume a burst that was interrupted or lacks images; its cameras count as heard at `heard_ns`.

        Blocks on the disk. Raises BadInputError where the session has no plan, TryAgainError where another
        process writes it.
        """
        writer = SessionWriter.resume(folder)
        assert writer.plan is not None
        deliveries = [
            CameraDelivery(plan, heard_ns, instants=writer.instants_of(plan.camera.name))
            for plan in writer.plan.cameras
        ]
        session = cls(
            burst_of(writer.plan),
            deliveries,
            writer,
            disk,
            lost=lost_images(writer, deliveries),
            absent={camera.name: camera for camera in writer.plan.burst.absent},
        )
        session._is_of_this_run, session.is_closing = is_of_this_run, is_closing
        session.session = folder if (folder / MANIFEST).exists() else None
        return session

    async def write_plan(
        self,
        leader: int,
        note: str = "",
        pins: Mapping[str, str] | None = None,
        unix_minus_leader_ns: int | None = None,
    ) -> None:
        """Write the burst's plan to disk; `leader` is the id by which nodes know this run of the leader.

        `note` is for the manifest, `pins` are the cameras' machines. The last tells a later run of the leader
        whether its clock is still the same. Raises DiskFullError where there is no room for it.
        """
        self._plan = BurstPlan(
            name=self._writer.name,
            created=self._writer.created,
            software=self._writer.software,
            leader=leader,
            number=self.burst.number,
            burst=burst_record(self.burst, self._absent),
            cameras=(),
            pins={name: pin for name, pin in (pins or {}).items() if pin},
            spare=self.burst.spare,
            note=note,
            unix_minus_leader_ns=unix_minus_leader_ns,
        )
        await self._save_plan(self._choice.requested)

    # Status and summaries

    @property
    def status(self) -> BurstStatus:
        """Progress of the burst; a burst of an earlier run has no number in this one.

        A finished session that was opened again, as its images still arrive, is not done.
        """
        done = self.finished.is_set()
        is_ordered = done and not is_open_ended(self.burst.frames, self.burst.step_ns)
        instants = self.burst.frames if is_ordered else self._recorded_instants
        if self.burst.video and self._is_of_this_run and not done:
            # What cameras have not encoded yet counts too, or the progress would jump back at the end.
            instants = max(instants, bisect_right(self.burst.instants_ns, self._now_ns))
        parts = {
            name: (len(delivery.instants), delivery.given_up, delivery.plan.camera.facts.label)
            for name, delivery in self._deliveries.items()
        }
        parts |= {name: (0, camera.reason, camera.label) for name, camera in self._absent.items()}
        transfer = tuple(
            CameraTransfer(camera=name, received=received, expected=instants, problem=problem, label=label)
            for name, (received, problem, label) in sorted(parts.items())
        )
        moved = f"its folder is {self._writer.moved_to} now" if self._writer.moved_to else ""
        without = "; ".join(f"without {of.label or of.name}: {of.reason}" for of in self._absent.values())
        received, expected = sum(t.received for t in transfer), sum(t.expected for t in transfer)
        message = self.message or ("" if done else self.trouble or self._waiting_text())
        if self._lost is not None and not done:
            arriving = sum(
                instants - len(delivery.instants)
                for delivery in self._deliveries.values()
                if delivery.streams
            )
            awaits = f"{arriving} arriving" if arriving else "waiting for images that its nodes still have"
            message = message or awaits
        if not self._is_of_this_run:
            whose = f"{self._writer.name} of an earlier run: {received} of {expected} images"
            message = ("; " if done else ", ").join(filter(None, (whose, message)))
        return BurstStatus(
            burst=self.burst.number if self._is_of_this_run else 0,
            name=self._writer.name,
            cameras=len(self._deliveries),
            instants=instants,
            received=received,
            expected=expected,
            done=done,
            session=None if self.session is None else str(self.session),
            message="; ".join(filter(None, (without, message, moved))),
            transfer=transfer,
            recording=self.burst.video,
            ended=self.burst.video and (done or self._is_cut_off or self._now_ns > self._ends_ns),
            skipped=self._choice.skipped(self._reported_plans),
            first_leader_ns=self.burst.instants_ns[0] if self._is_of_this_run else 0,
        )

    @property
    def folder(self) -> Path:
        """Folder of the session."""
        return self._writer.folder

    def to_continue(self, now_ns: int, unix_ns: int) -> int | None:
        """Return the leader's run that ordered this, if the present run can order the rest of it; else None.

        It can until the ordered end, while its clock is that of the earlier run.
        """
        plan, burst = self._plan, self.burst
        if plan is None or plan.unix_minus_leader_ns is None or self._is_of_this_run or not burst.streamed:
            return None
        if self.is_closing or self.session is not None or is_open_ended(burst.frames, burst.step_ns):
            return None
        is_same_clock = abs(unix_ns - now_ns - plan.unix_minus_leader_ns) <= SAME_CLOCK_NS
        return plan.leader if is_same_clock and now_ns < burst.instants_ns[-1] else None

    def planned_delays_ns(self) -> dict[str, int]:
        """Return the delay of each camera that was ordered to take part, as planned or as it reported."""
        return {name: delivery.plan.camera.delay_ns for name, delivery in self._deliveries.items()}

    def mean_image_bytes(self) -> dict[str, int]:
        """Return the mean size in bytes of each camera's images and their ground truth, where any arrived."""
        return self._intake.mean_bytes()

    def silent_cameras(self) -> set[str]:
        """Return the cameras that have delivered nothing and were given up because they were silent."""
        return {
            name for name, delivery in self._deliveries.items() if delivery.silent and not delivery.instants
        }

    def is_empty(self) -> bool:
        """Return whether no image has arrived yet."""
        return not any(delivery.instants for delivery in self._deliveries.values())

    def is_overrun(self, now_ns: int) -> bool:
        """Return whether a camera takes frames after the last instant, as it has missed the order to end.

        False for a burst of an earlier run of the leader, which cannot give it.
        """
        if not self.burst.streamed or now_ns < self.burst.instants_ns[-1] + AFTER_LAST_INSTANT_NS:
            return False
        return self._is_of_this_run and any(
            delivery.plan.picking and not delivery.given_up for delivery in self._deliveries.values()
        )

    # Incoming reports and images

    def check_machine(self, camera: str, pin: str) -> None:
        """Raise BadInputError if this camera's part belongs to another machine."""
        if self._plan is not None:
            check_machine(self._plan, camera, pin)

    def stream_opened(self, camera: str) -> None:
        """Note that a camera is connected, so that its images may take longer."""
        self._delivery(camera).streams += 1

    def stream_closed(self, camera: str, now_ns: int) -> None:
        """Note that a camera's stream broke off or was closed."""
        self._delivery(camera).streams -= 1
        self._delivery(camera).note_heard(now_ns)

    def contains(self, leader_ns: int) -> bool:
        """Return whether a time falls into this burst, MARK_MARGIN_NS around it included."""
        instants_ns = self.burst.instants_ns
        return (
            not self.finished.is_set()
            and self._is_of_this_run
            and instants_ns[0] - MARK_MARGIN_NS <= leader_ns <= instants_ns[-1] + MARK_MARGIN_NS
        )

    async def place_mark(self, mark: Mark) -> None:
        """Store a mark among the session's events. Raises DiskError."""
        await on_disk(self._disk, self._writer.add_event, mark.as_event())

    async def accept_report(self, report: CameraReport, now_ns: int, *, wait_s: float = 0.0) -> ReportAck:
        """Store a camera's report of what it will send; return which images to send, and which are here.

        While that depends on other cameras it waits up to `wait_s` for them. Raises BadInputError for a
        report that does not belong to this burst, DiskError while the disk does not accept it.
        """
        delivery, plan = self._delivery(report.plan.camera.name), report.plan
        if self.burst.streamed:
            # The camera may have learned late that the burst ends earlier.
            plan = replace(
                plan,
                instants=tuple(n for n in plan.instants if n < self.burst.frames),
                missing=tuple(gap for gap in plan.missing if gap.instant < self.burst.frames),
            )
        else:
            # A node that was killed has lost some; only spare instants may still be to come.
            plan = settled(plan, self.burst.frames)
        try:
            check_report(plan, self.burst, self._passed(now_ns))
        except BadInputError as error:
            await self.give_up_camera(delivery.name, error.what)
            raise
        try:
            async with self._intake.writing[delivery.name]:
                self._intake.check_open()
                first = not delivery.plan.reported
                if first and report.events:
                    await on_disk(
                        self._disk,
                        self._writer.add_event,
                        *({**event, "camera": delivery.name} for event in report.events),
                    )
                delivery.note_report(plan, now_ns)
                self._now_ns = max(self._now_ns, now_ns)
                await self._commit_instants()
                if self._choice.committed.is_set():
                    await self._save_plan(self._choice.requested)
        except DiskError as error:
            self.trouble = str(error)
            if self.burst.streamed:
                self._note_disk_error(error)
            raise
        self.trouble = ""
        if not await has_come(self._choice.committed, wait_s):
            return ReportAck(undecided=True)
        receipts = await on_disk(
            self._disk, delivery.receipts, self._writer, self._choice, reported_only=self.burst.streamed
        )
        await self.finish_if_complete()
        end = self.burst.frames if self.burst.streamed else None
        return ReportAck(receipts=receipts, requested=self._choice.requested, end=end)

    async def take(
        self, batch: ImageBatch, payload: AsyncIterator[bytes], now_ns: int
    ) -> "asyncio.Future[str]":
        """Receive images; the returned future yields the batch's checksum once they are on disk.

        Raises BadInputError, DamagedImageError, DiskError, as does the future. Raises
        TryAgainError for an image that was damaged on its way, or that differs from the one that its session
        has.
        """
        delivery, facts = self._delivery(batch.camera), self._delivery(batch.camera).plan.camera.facts
        if len({(image.leader, image.burst, image.record.camera) for image in batch.images}) > 1:
            raise BadInputError(f"{batch.camera} sent images of several bursts in one message")
        ordered = [image.record.instant for image in batch.images]
        batch = ImageBatch(images=tuple([await self._expected(image) for image in batch.images]))
        numbers = [image.record.instant for image in batch.images]
        try:
            saving = await self._intake.receive(batch, payload, (facts.width, facts.height))
        except DamagedImageError as error:
            for instant in error.instants:
                delivery.note_damaged(ordered[numbers.index(instant)], error.what)
            raise DamagedImageError(
                error.what, instants=tuple(ordered[numbers.index(number)] for number in error.instants)
            ) from None
        except DiskError as error:
            self._note_disk_error(error)
            raise
        saving.add_done_callback(functools.partial(self._note_saved, delivery, numbers))
        delivery.note_heard(now_ns)
        return saving

    async def _expected(self, upload: ImageUpload) -> ImageUpload:
        """Return an upload as its session stores it, with its number there. Raises as `take`."""
        self._intake.check_open()
        if self.burst.streamed and upload.record.instant >= self.burst.frames:
            # The node learns from the answer to its next report that it may delete the frame.
            raise TryAgainError(f"burst {self.burst.number} has ended before instant {upload.record.instant}")
        number, suffix = self._choice.number(upload.record.instant), check_image_path(upload.record)
        delivery = self._delivery(upload.record.camera)
        if problem := size_problem(upload, delivery.plan.camera.facts):
            await self.give_up_camera(delivery.name, problem.what)
            raise problem
        return replace(
            upload,
            record=replace(
                upload.record,
                instant=number,
                path=image_path(delivery.name, number, suffix),
                # A node that was started again during a recording did not know how late its frames are.
                late=delivery.plan.camera.is_late(upload.record.residual_ns),
            ),
        )

    def _note_saved(
        self, delivery: CameraDelivery, numbers: Iterable[int], saved: "asyncio.Future[str]"
    ) -> None:
        if saved.cancelled():
            return
        if (error := saved.exception()) is None:
            for number in numbers:
                delivery.instants.add(number)
            # Acknowledged before the session is finished, which takes the disk some time.
            if self._may_finish():
                self._background.start(self.finish_if_complete())
        elif isinstance(error, DiskError):
            self._note_disk_error(error)

    def _note_disk_error(self, error: DiskError) -> None:
        """Finish the burst, unless more is to come: then its cameras store it until the disk accepts it.

        What a person has deleted is not awaited.
        """
        is_deleted = isinstance(error.__cause__, FileNotFoundError)
        if self.burst.streamed and not is_deleted and self._now_ns < self._ends_ns:
            self.trouble = f"{error}; the cameras keep their images meanwhile"
        else:
            is_full = isinstance(error, DiskFullError)
            reason = "the leader's disk is full" if is_full else f"at the leader: {error.what}"
            self._background.start(self.break_off(reason))

    # Choice of instants, and the plan

    async def _commit_instants(self) -> None:
        """Commit the burst to its instants if that is possible now, on disk before any node learns of them.

        Raises DiskFullError; the burst is then committed to nothing.
        """
        async with self._committing:
            if self._choice.committed.is_set():
                return
            if self._now_ns >= self._ends_ns + AFTER_LAST_INSTANT_NS + CAMERA_DISCONNECTED_NS:
                for delivery in self._deliveries.values():
                    if delivery.plan.reported:
                        delivery.plan = settled(delivery.plan, len(self.burst.instants_ns))
            awaited = [of.reported_plan for of in self._deliveries.values() if not of.given_up]
            chosen = choose_instants(len(self.burst.instants_ns), self.burst.frames, awaited)
            if chosen is not None:
                await self._save_plan(chosen)
                self._choice.commit(chosen)

    async def _save_plan(self, chosen: tuple[int, ...] | None) -> None:
        """Write the cameras' reports and the chosen instants to disk. Raises DiskFullError.

        Returns once they are on disk. Changes that arrive during a write are combined in the next one.
        """
        if self._plan is None:
            return
        plans = tuple(delivery.plan for delivery in self._deliveries.values())
        self._plan = replace(self._plan, cameras=plans, chosen=chosen, streamed=instant_range(self.burst))
        async with self._writing_plan:
            if self._plan != self._writer.plan:
                await on_disk(self._disk, self._writer.set_plan, self._plan)

    # The end of the burst

    async def end(self, burst: Burst) -> None:
        """Shorten the burst to the instants of `burst`, as it ends earlier than ordered."""
        self.burst = burst
        self._choice.end(burst)
        # On a full disk it is written when the session is finished, which may be now.
        with suppress(DiskError, TryAgainError):
            await self._save_plan(self._choice.requested)
        await self.finish_if_complete()

    async def break_off(self, reason: str) -> None:
        """Finish now, with `reason`; a streamed burst ends. Its cameras keep what is missing."""
        if self.order_end is not None and self._broken_off is None:
            self._broken_off = self.order_end()
        await self.finish_now(reason)

    async def give_up_camera(self, name: str, reason: str, *, silent: bool = False) -> None:
        """Stop waiting for a camera; `silent` if it may still have its images."""
        if (delivery := self._deliveries.get(name)) is None or delivery.is_complete(self._choice):
            return
        delivery.given_up, delivery.silent = reason, silent
        try:
            await self._commit_instants()
        except SimulshotError as error:
            # No node may learn of instants that a crash would renumber.
            self._choice.commit(range(self.burst.frames))
            for other in self._deliveries.values():
                other.given_up = other.given_up or error.what
        await self.finish_if_complete()

    def new_bytes(self) -> Counter[str]:
        """Return how many bytes of each camera's images have arrived since the last call."""
        grown = Counter[str]()
        for name, delivery in self._deliveries.items():
            arrived = self._intake.arrived_bytes(name)
            grown[name], delivery.counted_bytes = arrived - delivery.counted_bytes, arrived
        return grown

    async def give_up_silent_cameras(
        self, lost: Mapping[str, str], now_ns: int, new_bytes: Mapping[str, int] | None = None
    ) -> None:
        """Stop waiting for cameras that have no stream, are lost (name to reason), or have stalled.

        `new_bytes` are those of each camera's images in all bursts, in which it may be busy.
        """
        new_bytes = self.new_bytes() if new_bytes is None else new_bytes
        self._now_ns = now_ns
        # On a full disk, or in a folder that is being renamed, it is committed by a later report.
        with suppress(DiskError, TryAgainError):
            await self._commit_instants()
        is_undecided = not self._choice.committed.is_set() and any(
            not (of.plan.reported or of.given_up) for of in self._deliveries.values()
        )
        for name, delivery in self._deliveries.items():
            delivery.note_arrivals(new_bytes.get(name, 0), now_ns)
            if delivery.plan.reported and is_undecided:
                # It waits for the others.
                delivery.since_ns = max(delivery.since_ns, now_ns)
            if not self._intake.is_saving(name) and (
                reason := delivery.why_silent(lost, now_ns, self._ends_ns)
            ):
                await self.give_up_camera(name, reason, silent=True)
        # A camera may have sent a damaged image last, and no report since.
        await self.finish_if_complete()

    async def finish_now(self, reason: str, *, silent: bool = True) -> None:
        """Finish now, with the images received so far; `reason` is recorded with the missing ones.

        Without any image, a session is made only if `silent`: the cameras may still have their images.
        """
        self.is_closing = True
        for name in self._deliveries:
            await self.give_up_camera(name, reason, silent=silent)
        await self.finish_if_complete()

    async def finish_if_complete(self) -> None:
        """Write the manifest once nothing is awaited any more; harmless before and after."""
        if not self._may_finish():
            return
        async with self._intake.at_rest():
            if not self._may_finish():
                return
            try:
                self.session = await on_disk(self._disk, self._finish)
            except SimulshotError as error:
                self.failure = error
                self.message = f"{error}; then: capture-app sessions repair {self.folder}"
                if not self.folder.exists():
                    self.failure = BadInputError(
                        f"{self.folder} was removed while it was being written",
                        hint="its cameras keep the images that were not saved before",
                    )
                    self.message = str(self.failure)
                await on_disk(self._disk, self._writer.abort)
            self.finished.set()

    async def suspend(self) -> None:
        """Stop without finishing, so that `resume` can continue."""
        async with self._intake.at_rest():
            if not self.finished.is_set():
                await on_disk(self._disk, self._writer.abort)
                self.message = (
                    "left unfinished: the next leader continues it,"
                    f" or: capture-app sessions repair {self.folder}"
                )
                self.finished.set()

    def _may_finish(self) -> bool:
        return (
            not self.finished.is_set()
            and all(delivery.is_complete(self._choice) for delivery in self._deliveries.values())
            and not self._awaited
        )

    @property
    def _is_cut_off(self) -> bool:
        """Whether it is a recording without an end that an earlier run of the leader left."""
        return not self._is_of_this_run and is_open_ended(self.burst.frames, self.burst.step_ns)

    @property
    def _awaited(self) -> list[CameraDelivery]:
        """Silent or restarted cameras of a streamed burst, for which it stays open until its end.

        While no other camera takes any frames, what these share has failed, such as an access point or their
        machine. They deliver their frames when it is back, and are asked for the rest when they are ready.
        """
        deliveries = self._deliveries.values()
        # One that was finished before is only opened for what its cameras bring.
        if not self.burst.streamed or self.session is not None or self.is_closing:
            return []
        # Nobody orders the rest of a recording that was cut off.
        left_off = [of for of in deliveries if of.has_left_off(self.burst.frames) and not self._is_cut_off]
        awaited = [of for of in deliveries if of.silent or of in left_off]
        if not awaited or not all(of.is_complete(self._choice) for of in deliveries):
            return []
        until_ns = self._ends_ns
        if all(of in awaited or of.given_up for of in deliveries):
            is_silent = any(of.silent for of in awaited)
            until_ns += AFTER_LAST_INSTANT_NS + (CAMERA_DISCONNECTED_NS if is_silent else 0)
        until_ns = min(until_ns, max(of.heard_ns for of in awaited) + ALL_DISCONNECTED_NS)
        return awaited if self._now_ns < until_ns else []

    def _finish(self) -> Path | None:
        """Write the manifest with the images received so far, and return the session's folder.

        Return None if no image arrived or may still come. Blocks on the disk. Raises BadInputError where the
        records contradict each other, DiskFullError.
        """
        choice, writer, deliveries = self._choice, self._writer, self._deliveries.values()
        ordered = self.burst.frames
        if is_cut := self._recorded_instants < ordered:
            choice = InstantChoice(
                dataclasses.replace(
                    self.burst, instants_ns=self.burst.instants_ns[: max(1, self._recorded_instants)]
                )
            )
        missing = [
            gap for delivery in deliveries for gap in delivery.missing_images(choice, self._lost or {})
        ]
        burst = choice.record(self._reported_plans, self._absent)
        if is_cut and not is_open_ended(ordered, self.burst.step_ns):
            burst = replace(burst, ordered=ordered)
        titles = {delivery.name: delivery.title for delivery in deliveries}
        self.message = result_text(burst, missing, titles)
        if self.is_empty() and self._lost is None and not any(delivery.silent for delivery in deliveries):
            writer.discard()
            self.message = f"no image arrived, so no session was made; {self.message}"
            return None
        plans = {delivery.name: delivery.plan for delivery in deliveries}
        calibrated = {name: plan.calibration for name, plan in plans.items() if plan.calibration is not None}
        if calibrated:
            writer.set_calibration(Calibration(cameras=calibrated, source="the simulated scene"))
        writer.images.clocks = {
            n: plan.true_clock for n, plan in plans.items() if plan.true_clock is not None
        }
        return writer.finish(
            [plan.camera for plan in plans.values()],
            burst,
            missing,
            "simulated" if writer.knows_true_times else "captured",
            "" if writer.plan is None else writer.plan.note,
            plan=self._plan,
        ).folder

    # Parts

    @property
    def _recorded_instants(self) -> int:
        """Length in instants: of a recording, or what was broken off, as many as any camera has taken."""
        if not self.burst.video and self._broken_off is None:
            return self.burst.frames
        ends = [
            n
            for delivery in self._deliveries.values()
            for n in (delivery.plan.picked or 0, delivery.instants.end)
        ]
        # What an earlier run missed counts, too: else a recording that it broke off would be shorter here.
        ends += [instant + 1 for _, instant in self._lost or ()]
        return min(self.burst.frames, max(self._broken_off or 0, *ends))

    def _passed(self, now_ns: int) -> int:
        """Return the largest number of instants that a camera can have seen by now.

        A camera that learns late of the burst's end has seen more instants than the burst has now. In a
        resumed burst the number is not limited, because the leader's clock of the earlier run may differ.
        """
        passed = (now_ns + AFTER_LAST_INSTANT_NS - self.burst.instants_ns[0]) // self.burst.step_ns + 1
        return max(0, passed) if self._lost is None else MAX_STREAMED_FRAMES

    @property
    def _ends_ns(self) -> int:
        """Leader time of the last instant; a resumed burst lasts no longer again, as its times may differ.

        Cameras end one without an ordered end themselves when another run of the leader comes.
        """
        first_ns, last_ns = self.burst.instants_ns[0], self.burst.instants_ns[-1]
        if self._lost is None:
            return last_ns
        if is_open_ended(len(self.burst.instants_ns), self.burst.step_ns):
            return self._began_ns
        return min(last_ns, self._began_ns + last_ns - first_ns)

    @property
    def _reported_plans(self) -> dict[str, CameraPlan | None]:
        return {name: delivery.reported_plan for name, delivery in self._deliveries.items()}

    def _delivery(self, name: str) -> CameraDelivery:
        if name not in self._deliveries:
            raise BadInputError(f"camera {name!r} is not in burst {self.burst.number}")
        return self._deliveries[name]

    def _waiting_text(self) -> str:
        """Return in words what the burst waits for: the disk, or cameras without a report; '' if nothing."""
        images, seconds = self._intake.waiting()
        if seconds >= SAID_AFTER_S:
            return f"waiting for the disk: {count(images, 'image')}, {seconds:.0f} s"
        if awaited := self._awaited:
            names = ", ".join(sorted(delivery.title for delivery in awaited))
            whom = "all cameras" if len(awaited) == len(self._deliveries) else names
            silent_s = max(0, self._now_ns - max(delivery.heard_ns for delivery in awaited)) // 10**9
            if not any(delivery.silent for delivery in awaited):
                return f"waiting until {whom} {'are' if len(awaited) > 1 else 'is'} ready again"
            return f"waiting for {whom}, {silent_s} s; they keep their pictures"
        late = [
            delivery
            for _, delivery in sorted(self._deliveries.items())
            if not delivery.is_complete(self._choice)
        ]
        unreported = [delivery.title for delivery in late if not delivery.reported_plan]
        if unreported and not self._choice.committed.is_set() and len(unreported) < len(self._deliveries):
            return f"waiting to hear from {', '.join(unreported)}"
        # In a long burst the next frame may be hours away, and a burst of an earlier run has other times.
        if (
            not late
            or self.burst.streamed
            or self._lost is not None
            or self._now_ns - self.burst.instants_ns[-1] < SAID_AFTER_S * 1e9
        ):
            return ""
        return f"waiting for images of {', '.join(of.title for of in late)}"


def lost_images(writer: SessionWriter, deliveries: Iterable[CameraDelivery]) -> Lost:
    """Return the images that an earlier run's session lists as missing or damaged. Blocks on the disk.

    If that session was finished, no camera is awaited any more; images that it gave up may still come.
    """
    lost = {
        (camera, instant): MissingImage(
            camera=camera, instant=instant, reason="its file was damaged or lost after it arrived"
        )
        for camera, instant in writer.images.damaged
    }
    try:
        missing = Session.open(writer.folder).stored_manifest.missing
    except SimulshotError:
        return lost
    for delivery in deliveries:
        delivery.given_up = next(
            (gap.reason for gap in missing if gap.camera == delivery.name), "it never came"
        )
        delivery.silent = True
    return lost | {(gap.camera, gap.instant): gap for gap in missing}

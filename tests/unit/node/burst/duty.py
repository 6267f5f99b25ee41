"""A leader's session and the nodes of its cameras, in histories that are drawn, without sockets or disks.

Each node is an `Upload` with its `Sender`, the leader a `BurstSession`. Messages wait in a link until the
leader takes them; a virtual clock jumps over all pauses.
"""

import asyncio
import contextlib
from collections import deque
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Sequence
from dataclasses import replace as with_fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.errors import DiskFullError, NetworkError, SimulshotError, UnwantedImageError
from capture_app.common.tasks import end
from capture_app.node.burst import burst_session, intake
from capture_app.node.burst.burst_session import BurstSession, lost_images
from capture_app.node.burst.camera_delivery import CameraDelivery
from capture_app.node.burst.plans import burst_of
from capture_app.node.camera import burst_upload, uploader
from capture_app.node.camera.burst_upload import Upload, UploadState, encode_frame
from capture_app.node.camera.uploader import Sender
from capture_app.protocol.log import Log
from capture_app.protocol.messages import CameraReport, ImageAck, ImageBatch, ImageUpload, Refusal, ReportAck
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan
from capture_app.session.format.manifest import BurstRecord, CameraRecord, ImageRecord, MissingImage
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.instant_set import InstantSet
from capture_app.sync.rig.frame_selection import DROPPED, Burst, FramesSelected, Gap, SelectedFrame
from capture_app.sync.wire.datagrams import Trigger
from tests.unit.node.bursts import CAMERA, DISK, LEADER, PERIOD_NS
from tests.unit.node.camera.uploading import TIME_MAP, Picture

ORDERED, SPARE, FIRST_NS = 6, 2, 10_000_000_000
NAMES = ("a", "b")
BROKEN = b"broken"
"""A picture that a leader cannot decode begins so."""
MAX_IMAGES = 3
_disks: list["Disk"] = []


class Disk:
    """A session's files in memory, in the place of a `SessionWriter`; what is synced stays."""

    name, created, software, moved_to, knows_true_times = "burst-001", "", "", None, False
    folder = Path("burst-001")

    def __init__(self) -> None:
        self.appended: dict[tuple[str, int], ImageRecord] = {}
        self.synced: dict[tuple[str, int], ImageRecord] = {}
        self.images = SimpleNamespace(damaged=(), clocks={})
        self.plan: BurstPlan | None = None
        self.missing: list[MissingImage] | None = None
        """Of the finished session; None while it is not."""
        self.burst: BurstRecord | None = None
        self.is_full = False
        self.is_calm = True
        """Whether nothing has happened but what is usual."""

    def _write(self) -> None:
        if self.is_full:
            raise DiskFullError("the leader's disk is full")

    def set_plan(self, plan: BurstPlan) -> None:
        self._write()
        self.plan = plan

    def add_event(self, *_: Any) -> None:
        self._write()

    def append(self, images: Sequence[StoredImage], *, in_videos: bool) -> None:
        self._write()
        for image in images:
            self.appended.setdefault((image.record.camera, image.record.instant), image.record)

    def sync(self, *_: str) -> None:
        if self.is_full:
            self.appended = dict(self.synced)
        self._write()
        self.synced = dict(self.appended)

    def image(self, camera: str, instant: int) -> ImageRecord | None:
        return self.synced.get((camera, instant))

    def has(self, camera: str, instant: int) -> bool:
        return (camera, instant) in self.synced

    def instants_of(self, camera: str) -> InstantSet:
        instants = InstantSet()
        for name, instant in self.synced:
            if name == camera:
                instants.add(instant)
        return instants

    def finish(self, _: Any, burst: BurstRecord, missing: list[MissingImage], *__: Any, plan: Any) -> Any:
        self._write()
        self.missing, self.burst, self.plan = missing, burst, plan
        numbers = {(name, n) for name in NAMES for n in range(len(burst.instants_ns))}
        there = {key for key in self.synced if key in numbers}
        told = {(gap.camera, gap.instant) for gap in missing}
        assert there | told == numbers, f"nothing is said of {numbers - there - told}"
        assert not there & told, "it is there, and said to be missing"
        if self.is_calm:
            never = [gap.instant for gap in missing if gap.reason == "it never came"]
            assert not never, f"nobody waited for {never}"
        return self

    def abort(self) -> None:
        self.appended = dict(self.synced)

    def discard(self) -> None:
        self.missing, self.burst = [], None

    @property
    def stored_manifest(self) -> Any:
        return self

    def open(self, _: Path) -> "Disk":
        if self.missing is None:
            raise SimulshotError("it has no manifest")
        return self


class Film:
    """A burst's images in a node's spool without a disk; `continue_from` and `of_spool` find them there."""

    def __init__(self, report: CameraReport, on_release: Callable[[ImageUpload], None]) -> None:
        self.film, self.report, self.folder = self, report, Path("spool")
        self.on_release = on_release
        self.images: dict[int, ImageUpload] = {}
        self.data: dict[int, bytes] = {}

    def read(self, images: Sequence[ImageUpload]) -> list[bytes | None]:
        return [self.data.get(image.record.instant) for image in images]

    def release(self, instants: Collection[int]) -> list[Path]:
        for instant in instants:
            if instant in self.images:
                self.on_release(self.images.pop(instant))
            self.data.pop(instant, None)
        return []

    def recover(self) -> list[ImageUpload]:
        return [*self.images.values()]

    def read_report(self) -> CameraReport:
        return self.report

    def write_report(self, report: CameraReport) -> None:
        self.report = report


class Link:
    """Stream between a node and the leader; both ends see it break off."""

    peer, has_spoken, who = "leader", True, SimpleNamespace(pin="")

    def __init__(self) -> None:
        self.sent: deque[tuple[Any, tuple[bytes, ...]]] = deque()
        self.answers: asyncio.Queue[Any] = asyncio.Queue()
        self.is_open = True
        self.saving: deque[tuple[ImageBatch, asyncio.Future[str]]] = deque()

    async def send(self, message: Any, *data: bytes, stall_s: float | None = None) -> None:
        if not self.is_open:
            raise NetworkError("the connection broke off")
        self.sent.append((message, data))

    async def receive(self) -> Any:
        answer = await self.answers.get()
        if isinstance(answer, Exception):
            raise answer
        return answer

    def answer_saved(self) -> None:
        while self.saving and self.saving[0][1].done():
            _, saved = self.saving.popleft()
            if not saved.cancelled():
                error = saved.exception()
                is_known = isinstance(error, SimulshotError)
                answer = Refusal.of_error(cast(SimulshotError, error)) if is_known else None
                self.answers.put_nowait(answer or ImageAck(sha256=saved.result()))


class Node:
    """One camera's node."""

    def __init__(self, name: str, streamed: bool, on_release: Callable[[ImageUpload], None]) -> None:
        self.name, self.streamed, self.on_release = name, streamed, on_release
        self.count = ORDERED + (0 if streamed else SPARE)
        self.next = 0
        self.lost: set[int] = set()
        """Instants whose frames are lost for a reason that this test knows."""
        self.taken: set[int] = set()
        self.refusal: Refusal | None = None
        self.upload = self._new_upload()
        self.film = cast(Film, self.upload.spooled)
        self.link, self.task = Link(), cast("asyncio.Task[None] | None", None)
        self.changed = asyncio.Event()

    def _new_upload(self) -> Upload:
        plan = CameraPlan(
            camera=CameraRecord(name=self.name, facts=CAMERA), reported=True, picking=self.streamed
        )
        report = CameraReport(leader=LEADER, burst=1, plan=plan)
        return Upload(report, spooled=cast(Any, Film(report, self.on_release)), streamed=self.streamed)

    @property
    def is_over(self) -> bool:
        return self.upload.state is UploadState.OVER or self.refusal is not None

    @property
    def is_begun(self) -> bool:
        return self.streamed or self.next >= ORDERED

    def frame(self, instant: int, data: bytes) -> SelectedFrame[CapturedFrame]:
        at_ns = FIRST_NS + instant * PERIOD_NS
        captured = CapturedFrame(instant, 0, at_ns, Picture(data))
        return SelectedFrame(instant, at_ns, at_ns, 0, 4, 5, 0, captured)

    def selected(
        self, frames: Sequence[SelectedFrame[CapturedFrame]], gaps: Sequence[int]
    ) -> FramesSelected[CapturedFrame]:
        trigger = Trigger(0, LEADER, 1, FIRST_NS, PERIOD_NS, self.count, streamed=self.streamed)
        missing = tuple(Gap(gap, DROPPED) for gap in gaps)
        return FramesSelected(trigger, tuple(frames), missing, TIME_MAP, None, further=True, over=self.next)

    def select(self, number: int) -> None:
        """The camera delivers the next frame, drops it, or delivers one that cannot be decoded."""
        if self.next == self.count:
            return
        instant, self.next = self.next, self.next + 1
        is_broken = number == 1
        data = (BROKEN if is_broken else b"picture") + b" %d of %s" % (instant, self.name.encode())
        frames = [] if number == 0 else [self.frame(instant, data)]
        before = len(self.upload.frames)
        self.upload.extend(self.selected(frames, [] if frames else [instant]))
        if len(self.upload.frames) > before:
            self.taken.add(instant)
            if is_broken:
                self.lost.add(instant)
        self.changed.set()

    def encode(self, _: int) -> None:
        if self.upload.frames:
            picked = self.upload.frames.popleft()
            image, data = encode_frame(self.upload.report, picked)
            self.film.images[picked.instant] = self.upload.images[picked.instant] = image
            self.film.data[picked.instant] = data
            if self.streamed:
                return
            self.film.report = self.upload.report
        if self.upload.ended and not self.upload.frames:
            self.film.report = self.upload.current_report()
        self.changed.set()

    def spoil(self, number: int) -> None:
        """The node's disk loses an image."""
        if self.film.data and number == 0:
            instant = next(iter(self.film.data))
            del self.film.data[instant]
            self.lost.add(instant)

    def connect(self, _: int = 0) -> None:
        if (self.task is None or self.task.done()) and self.is_begun and not self.is_over:
            self.link = Link()
            self.task = asyncio.create_task(self._send(self.upload))

    async def _send(self, upload: Upload) -> None:
        async with contextlib.aclosing(
            Sender(cast(Any, self.link), self.changed, Log(lambda _: None), [upload], ())
        ) as sender:
            try:
                _, refusal = await sender.next_ended()
            except NetworkError:
                return
        if refusal is None or refusal.forget:
            upload.end()
        else:
            self.refusal = refusal

    def break_off(self, _: int) -> None:
        """The stream breaks off; what was on its way is lost, or arrives all the same."""
        self.link.is_open = False
        self.link.answers.put_nowait(NetworkError("the connection broke off"))

    def restart(self, number: int) -> None:
        """The node is killed and started again; of a streamed burst it may go on with later frames."""
        if not self.is_begun or self.upload.state is UploadState.OVER:
            return
        self.break_off(0)
        if self.task is not None:
            self.task.cancel()
        self.lost |= {frame.instant for frame in self.upload.frames}
        left = Upload.of_spool(cast(Any, self.film))
        self.refusal = None
        if self.streamed and self.next < self.count and number:
            again = self._new_upload()
            again.extend(self.selected([], range(self.next)))
            again.continue_from(left)
            self.upload = again
        else:
            self.upload = left
            self.next = self.count
        self.changed = asyncio.Event()


class Rig:
    """A leader with its session, and two nodes; each method is something that happens."""

    def __init__(self, streamed: bool) -> None:
        self.streamed = streamed
        instants_ns = tuple(FIRST_NS + n * PERIOD_NS for n in range(ORDERED + (0 if streamed else SPARE)))
        burst = Burst(1, instants_ns, PERIOD_NS, FIRST_NS, NAMES, 0 if streamed else SPARE, streamed=streamed)
        self.disk, self.now_ns = Disk(), FIRST_NS + 10 * PERIOD_NS
        _disks[:] = [self.disk]
        self.session = BurstSession.begin(burst, dict.fromkeys(NAMES, CAMERA), cast(Any, self.disk), DISK)
        self.nodes = {name: Node(name, streamed, self._released) for name in NAMES}
        self.is_cancelled = False
        self.decided: tuple[int, ...] | None = None
        self.end_frames = ORDERED

    async def begin(self) -> None:
        await self.session.write_plan(LEADER)

    def _released(self, image: ImageUpload) -> None:
        """A node deletes an image."""
        camera, instant = image.record.camera, image.record.instant
        if not self.is_cancelled and instant not in self.nodes[camera].lost and self._is_needed(instant):
            assert self.saved(camera, instant) == image.sha256, "it is deleted, and nobody has it"

    def _is_needed(self, instant: int) -> bool:
        return instant < self.end_frames if self.streamed else self.decided is None or instant in self.decided

    def saved(self, camera: str, instant: int) -> str | None:
        """Return the checksum of an image on the leader's disk, by its instant as ordered."""
        number = instant if self.decided is None else self.decided.index(instant)
        image = self.disk.image(camera, number)
        return None if image is None else image.sha256

    def check(self) -> None:
        """What a node has taken is here, or at the leader."""
        for node in self.nodes.values():
            here = {*node.upload.images, *(of.record.instant for of in node.upload.disputed)}
            here |= {frame.instant for frame in node.upload.frames}
            for instant in node.taken - here - node.lost:
                if not self.is_cancelled and self._is_needed(instant):
                    assert self.saved(node.name, instant), f"{node.name}/{instant} is neither here nor there"

    async def finish(self) -> None:
        """Let everything be well again, until nothing more is sent."""
        self.disk.is_full = False
        for turn in range(100):
            for number, node in enumerate(self.nodes.values()):
                while node.next < node.count:
                    node.select(2)
                if node.streamed and not node.upload.ended:
                    node.upload.extend(node.selected([], []))
                if turn % 4 >= number:
                    node.encode(0)
                node.connect()
            await asyncio.sleep(5)
            for name in (*NAMES, *NAMES):
                await self.serve(name)
                await asyncio.sleep(0.01)
            self.check()
            self.now_ns += 10**9
            if all(node.is_over for node in self.nodes.values()) and self.session.finished.is_set():
                break
            await self.session.give_up_silent_cameras({}, self.now_ns)
        assert self.session.finished.is_set(), "it never ends"
        self.check_end()

    def check_end(self) -> None:
        """Everything that was taken is saved, and what was chosen is what all cameras have."""
        both = sorted(set[int].intersection(*(node.taken for node in self.nodes.values())))
        if self.disk.is_calm and not self.streamed and not any(node.lost for node in self.nodes.values()):
            assert len(both) < ORDERED or self.decided == tuple(both[:ORDERED]), "it chose too early"
        for node in self.nodes.values():
            assert node.is_over, f"{node.name} goes on for ever: {node.upload.state} {node.refusal}"
            for instant in node.taken - node.lost:
                if not self.is_cancelled and self._is_needed(instant):
                    assert self.saved(node.name, instant), (
                        f"{node.name}/{instant} was never saved: {node.upload.state} {node.refusal}"
                    )

    # What happens

    async def serve(self, name: str, number: int = 0) -> None:
        """The leader takes the next message of a node."""
        node = self.nodes[name]
        link = node.link
        link.answer_saved()
        if not link.sent:
            return
        message, data = link.sent.popleft()
        try:
            if isinstance(message, CameraReport):
                link.answers.put_nowait(await self._report(message))
            else:
                session = await self._session()
                link.saving.append((message, await session.take(message, _pieces(data), self.now_ns)))
                await asyncio.sleep(0)
                link.answer_saved()
        except SimulshotError as error:
            while link.saving:
                await asyncio.wait([saving for _, saving in link.saving])
                link.answer_saved()
            link.answers.put_nowait(Refusal.of_error(error))

    async def _session(self) -> BurstSession:
        if self.is_cancelled:
            raise UnwantedImageError("the burst was cancelled")
        if self.session.finished.is_set():
            await self._resume()
        return self.session

    async def _resume(self) -> None:
        plan = self.disk.plan
        assert plan is not None
        deliveries = [
            CameraDelivery(of, self.now_ns, instants=self.disk.instants_of(of.camera.name))
            for of in plan.cameras
        ]
        if not deliveries:
            raise SimulshotError("it has no cameras yet")
        lost = lost_images(cast(Any, self.disk), deliveries)
        self.session = BurstSession(burst_of(plan), deliveries, cast(Any, self.disk), DISK, lost=lost)
        self.session.session = None if self.disk.missing is None else self.disk.folder

    async def _report(self, report: CameraReport) -> ReportAck:
        session = await self._session()
        answer = await session.accept_report(report, self.now_ns)
        if not answer.undecided and not self.streamed:
            assert self.decided in (None, answer.requested), "the leader took back which instants it needs"
            self.decided = answer.requested
        for receipt in answer.receipts:
            number = receipt.instant if self.decided is None else self.decided.index(receipt.instant)
            assert self.disk.has(report.camera, number), "it is not on the disk, and was confirmed"
        return answer

    async def fill(self, _: str, number: int) -> None:
        self.disk.is_full = number == 0

    async def end(self, _: str, number: int) -> None:
        """The operator ends a streamed burst."""
        if self.streamed and not self.session.finished.is_set() and 0 < number < self.session.burst.frames:
            burst = self.session.burst
            self.end_frames = number
            await self.session.end(with_fields(burst, instants_ns=burst.instants_ns[:number]))

    async def cancel(self, _: str, number: int) -> None:
        if number == 0 and not self.session.finished.is_set():
            self.is_cancelled = True
            await self.session.finish_now("the burst was cancelled", silent=False)

    async def wait(self, _: str, number: int) -> None:
        """Time passes: cameras that are silent are given up."""
        self.now_ns += number * 60 * 10**9
        await self.session.give_up_silent_cameras({}, self.now_ns)

    async def save_other(self, name: str, number: int) -> None:
        """The session gets another image in an instant's place, as of a camera of the same name."""
        if self.streamed and not self.disk.has(name, number) and not self.session.finished.is_set():
            image, _ = encode_frame(self.nodes[name].upload.report, self.nodes[name].frame(number, b"other"))
            self.disk.appended[name, number] = self.disk.synced[name, number] = image.record
            self.session._deliveries[name].instants.add(number)
            self.nodes[name].lost.add(number)

    async def restart_leader(self, _: str, number: int) -> None:
        for node in self.nodes.values():
            node.break_off(0)
        self.disk.is_full = False
        await self.session.suspend()
        await asyncio.sleep(0.1)
        if not self.is_cancelled and self.disk.plan is not None and self.disk.plan.cameras:
            await self._resume()


USUAL = ("select", "select", "encode", "encode", "connect", "serve", "serve", "serve")
"""What makes a burst go on."""
FAULTS = (
    "spoil",
    "break_off",
    "restart",
    "fill",
    "end",
    "cancel",
    "wait",
    "restart_leader",
    "save_other",
)
"""What befalls it; a history has few kinds of these, as what is usual is seldom undisturbed otherwise."""


async def happen(streamed: bool, history: Iterable[tuple[str, str, int]]) -> None:
    """Let steps happen, each at a camera and with a number; then let everything be well."""
    rig = Rig(streamed)
    await rig.begin()
    for step, name, number in history:
        rig.disk.is_calm &= step in USUAL
        if (of_rig := getattr(rig, step, None)) is not None:
            await of_rig(name, number)
        else:
            getattr(rig.nodes[name], step)(number)
        await asyncio.sleep(0.01)
        rig.check()
    await rig.finish()
    for node in rig.nodes.values():
        if node.task is not None:
            await end(node.task)
    await rig.session._background.end()


def small_batches(patch: pytest.MonkeyPatch) -> None:
    """Let batches be small, and pictures be what this module makes of them."""
    patch.setattr(burst_upload, "MAX_BATCH_IMAGES", MAX_IMAGES)
    patch.setattr(uploader, "next_message", lambda link, *_: link.receive())
    patch.setattr(burst_session, "Session", SimpleNamespace(open=lambda folder: _disks[-1].open(folder)))
    patch.setattr(intake, "damage", lambda data, _: "cut off" if data.startswith(BROKEN) else "")


async def _pieces(data: Sequence[bytes]) -> AsyncIterator[bytes]:
    for piece in data:
        yield piece

"""Patches of the product in a virtual rig: orders, confirmations and syncs are noted, and cameras lie."""

import asyncio
import contextlib
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any
from unittest.mock import patch
from weakref import WeakKeyDictionary

from capture_app.common import system
from capture_app.common.node_state import NodeState
from capture_app.net.channel import Channel
from capture_app.node import joining
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.camera.burst_upload import Upload
from capture_app.node.camera.spool import SpoolFolder
from capture_app.node.leader.bursts import ActiveBursts
from capture_app.protocol.messages import CameraReport, ImageBatch, ImageUpload
from capture_app.rig import rig_time
from capture_app.sync.phase import frame_line
from capture_app.sync.rig.leader_engine import Leader
from capture_app.sync.rig.roster import Member
from capture_app.sync.timekeeping import poll_schedule
from capture_app.sync.wire.datagrams import Heartbeat
from tests.virtual.evidence import OrderedBurst
from tests.virtual.plan import TWICE
from tests.virtual.world import process

if TYPE_CHECKING:
    from tests.virtual.rig import VirtualRig

READY = (NodeState.READY, NodeState.DEGRADED)
RARE = {
    "first_interval_ns": 20_000_000,
    "easing_intervals_ns": (60_000_000,),
    "poll_interval_ns": 500_000_000,
    "near_ns": 0,
}
"""Intervals of the exchanges between a node and its leader."""
FEW: dict[str, Any] = {
    "FIRST_SAMPLES": 100,
    "EASING_SAMPLES": 50,
    "SPACING_NS": 20_000_000,
    "TREE_INTERVAL_NS": 200_000_000,
}
"""Exchanges after a node's start, and those of relays and standbys."""
SEARCH_EVERY_FRAMES = 60
"""Frames between searches for a step of the timestamps: these cameras have none."""
ESTIMATE_EVERY_NS = 400_000_000
"""Interval of a node's estimates of its clock: each takes in what one exchange or two have shown."""


@contextlib.contextmanager
def observed(rig: "VirtualRig") -> Iterator[None]:
    """Note what is ordered and confirmed within the block, let liars lie, and let nodes ask seldom."""
    with contextlib.ExitStack() as stack:
        for patched in (*_observers(rig), _lies(rig), *_seldom()):
            stack.enter_context(patched)
        yield


def _observers(rig: "VirtualRig") -> Iterator[contextlib.AbstractContextManager[Any]]:
    evidence, world = rig.evidence, rig.world
    order, confirm = ActiveBursts.order, Upload.confirm
    add, sync = SpoolFolder.add, SpoolFolder.sync
    heard = Leader._receive_heartbeat
    unsynced: WeakKeyDictionary[SpoolFolder, list[ImageUpload]] = WeakKeyDictionary()

    async def ordering(bursts: ActiveBursts, *arguments: Any, **options: Any) -> BurstSession:
        members, ordered_ns = bursts._engine.roster.by_name(), world.now_ns
        ready = tuple(member.name for member in members if member.report.state in READY)
        run = bursts._engine.config.instance
        seen = frozenset(rig.seen[run])
        session: BurstSession = await order(bursts, *arguments, **options)
        one = process.get()
        assert one is not None
        evidence.bursts.append(
            OrderedBurst(
                (run, session.burst.number),
                session.status.name,
                session.burst,
                bursts._options.clock,
                ordered_ns,
                tuple(name for name in ready if name in session.burst.clients),
                session.folder,
                one.machine,
                session,
                seen,
            )
        )
        return session

    def confirming(upload: Upload, stored: Any) -> Any:
        report = upload.report
        for image in upload.images.values():
            instant, sha256 = image.record.instant, image.record.sha256
            if stored.get(instant) == sha256:
                key = report.leader, report.burst, report.camera, instant
                evidence.confirmed.setdefault(key, (sha256, world.now_ns))
        return confirm(upload, stored)

    def adding(folder: SpoolFolder, images: Iterable[tuple[ImageUpload, bytes]]) -> None:
        images = tuple(images)
        add(folder, images)
        unsynced.setdefault(folder, []).extend(image for image, _ in images)

    def syncing(folder: SpoolFolder) -> None:
        images = unsynced.pop(folder, [])
        sync(folder)
        for image in images:
            key = image.leader, image.burst, image.record.camera, image.record.instant
            evidence.synced.setdefault(key, (image.record.sha256, world.now_ns))

    def hearing(leader: Leader, member: Member, message: Heartbeat, now_ns: int) -> None:
        was_aligned, one = member.report.state.is_aligned, process.get()
        heard(leader, member, message, now_ns)
        if one is not None and message.report.state.is_aligned and not was_aligned:
            evidence.aligned.append((member.name, one.machine, world.now_ns))

    yield patch.object(Leader, "_receive_heartbeat", hearing)
    yield patch.object(ActiveBursts, "order", ordering)
    yield patch.object(Upload, "confirm", confirming)
    yield patch.object(SpoolFolder, "add", adding)
    yield patch.object(SpoolFolder, "sync", syncing)


def _lies(rig: "VirtualRig") -> contextlib.AbstractContextManager[Any]:
    send = Channel.send
    reported: WeakKeyDictionary[Channel[Any], CameraReport] = WeakKeyDictionary()

    async def sending(channel: Channel[Any], message: Any, *payloads: Any, **options: Any) -> None:
        lie = rig.plan.liars.get(getattr(process.get(), "name", ""), "")
        if isinstance(message, CameraReport):
            reported[channel] = message
        while lie == "silent" and isinstance(message, ImageBatch):
            # It says again and again what it has, and sends nothing of it.
            await asyncio.sleep(5)
            await send(channel, reported[channel])
        if lie == TWICE and isinstance(message, ImageBatch):
            message = ImageBatch(images=(*message.images, message.images[-1]))
            payloads = (*payloads, payloads[-1])
        is_short = isinstance(message, CameraReport) and message.plan.picked is None
        if lie in ("nothing", "partial") and is_short and not message.plan.picking:
            left = message.plan.instants[:1] if lie == "partial" else ()
            message = message.with_plan(instants=left, missing=())
        await send(channel, message, *payloads, **options)

    return patch.object(Channel, "send", sending)


def _seldom() -> Iterator[contextlib.AbstractContextManager[Any]]:
    """Exchanges are most of the work of a rig at rest: these nodes ask as seldom as among thousands."""

    def estimated(schedule: poll_schedule.SteadySchedule, now_ns: int, *, is_settled: bool) -> None:
        schedule.estimate_due_ns = now_ns + ESTIMATE_EVERY_NS

    yield patch.object(joining, "power_saving_towards", lambda _: None)
    yield patch.object(poll_schedule.SteadySchedule.__init__, "__kwdefaults__", dict(RARE))
    yield patch.object(poll_schedule.SteadySchedule, "estimated", estimated)
    yield patch.multiple(poll_schedule, **FEW)
    # Its default is the clock that was the host's when it was defined.
    yield patch.object(rig_time.read_rig_time, "__defaults__", (rig_time.EXCHANGES, system.monotonic_ns))
    yield patch.object(frame_line, "EVERY_FRAMES", SEARCH_EVERY_FRAMES)

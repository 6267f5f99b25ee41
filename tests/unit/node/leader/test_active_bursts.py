"""A leader's bursts: ordered, cancelled, and let go when they are saved."""

import asyncio
import hashlib
import random
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, DiskFullError, IncompleteError, UnwantedImageError
from capture_app.common.node_state import NodeState
from capture_app.common.timeouts import (
    AFTER_LAST_INSTANT_NS,
    CAMERA_DISCONNECTED_NS,
    FORGET_LOST_NS,
    MIN_UPLOAD_BYTES_PER_S,
    TRIGGER_GIVE_UP_NS,
)
from capture_app.machine.repair import repair
from capture_app.net.udp import Pump
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.leader import bursts as leader_bursts
from capture_app.node.leader.bursts import MAX_BURSTS_AHEAD, MAX_OPEN_BURSTS, ActiveBursts
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.log import Log
from capture_app.session.format.manifest import AbsentCamera
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import Verdict, judge
from capture_app.sync.rig.burst_orders import CANCELLED, NO_ANSWER, BurstOrder
from capture_app.sync.rig.events import TriggerAnswered
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.wire.codec import FromClient, decode
from capture_app.sync.wire.datagrams import (
    Goodbye,
    Heartbeat,
    Hello,
    Report,
    TimeRequest,
    Trigger,
    TriggerAck,
)
from capture_app.trust.trust import Trust
from tests.images import small_jpeg
from tests.unit.node.bursts import CAMERA, DISK, IMAGE, LEADER, pieces, receive_image, report, upload

pytestmark = pytest.mark.virtual

NOW_NS = 10**12


class StillClock:
    """A clock that the test alone moves."""

    shown_ns = NOW_NS
    local_from_true = true_from_local = staticmethod(lambda ns: ns)

    def now_ns(self) -> int:
        return self.shown_ns


def engine_of(*names: str) -> Leader:
    """A leader's engine that these cameras have joined."""
    engine = Leader(LeaderConfig(instance=LEADER, transfer_port=1), random.Random(1))
    for number, name in enumerate(names):
        engine.receive_message(Hello(name, number, CAMERA), (name, 0), NOW_NS)
        engine.receive_message(TimeRequest(engine.roster.members[name].number, 0, 0), (name, 0), NOW_NS)
    return engine


@asynccontextmanager
async def bursts_of(root: Path, engine: Leader, awaited: Sequence[str] = ()) -> AsyncIterator[ActiveBursts]:
    options = LeaderOptions(sessions=root, clock=StillClock(), trust=Trust.open(), awaited=awaited)
    bursts = ActiveBursts(options, engine, Pump(engine, options.clock, lambda: None))
    try:
        yield bursts
    finally:
        await bursts.close()


async def order(bursts: ActiveBursts, frames: int = 2) -> BurstSession:
    return await bursts.order(BurstOrder(frames=frames, spare=max(4, frames)))


def triggers_sent(engine: Leader, now_ns: int = NOW_NS) -> list[Trigger]:
    engine.handle_timer(now_ns)
    sent = (decode(data) for data, _ in engine.datagrams_to_send(now_ns))
    return [message for message in sent if isinstance(message, Trigger)]


async def test_a_cancelled_burst_is_forgotten_by_its_nodes(tmp_path: Path) -> None:
    engine = engine_of("a", "b")
    async with bursts_of(tmp_path, engine) as bursts:
        session = await order(bursts)
        number = session.burst.number
        await session.accept_report(report("a", 0, 1), NOW_NS)
        await bursts.cancel(number)
        assert session.status.done
        assert session.status.session is None
        assert not session.folder.exists()
        assert [(t.burst, t.count) for t in triggers_sent(engine)] == [(number, 0), (number, 0)]
        with pytest.raises(BadInputError, match="not under way"):
            await bursts.cancel(number)
        late = replace(report("b", 0, 1), burst=number)
        with pytest.raises(UnwantedImageError):
            await bursts.find_session(late, "")
        with pytest.raises(BadInputError, match="no session"):
            await bursts.find_session(replace(late, leader=LEADER + 1), "")
        again = await order(bursts)
        assert again.burst.number > number
        assert again.folder.name == "burst-002", "what somebody has noted of burst-001 is of no other"


@pytest.mark.parametrize("what", ["cancelled", "ended"])
def test_an_answer_to_the_end_of_a_burst_does_not_say_who_takes_part(what: str) -> None:
    orders, grid = (engine := engine_of("a")).orders, engine.grid
    member = engine.roster.members["a"]
    burst = orders.place(grid, NOW_NS, BurstOrder(frames=30, streamed=True))
    ack = TriggerAck(member.number, LEADER, burst.number)
    assert orders.take_ack(member, ack) == TriggerAnswered("a", burst.number, "")
    if what == "cancelled":
        orders.cancel(burst, NOW_NS)
        ack = replace(ack, refusal=CANCELLED)
    else:
        orders.end(burst, 5, NOW_NS)
    assert orders.take_ack(member, ack) is None


def test_a_late_answer_to_a_trigger_does_not_confirm_its_cancellation() -> None:
    orders, grid = (engine := engine_of("a")).orders, engine.grid
    member = engine.roster.members["a"]
    burst = orders.place(grid, NOW_NS, BurstOrder(frames=3))
    orders.cancel(burst, NOW_NS)
    assert not orders.is_busy(NOW_NS), "the rig may change its grid at once"
    ack = TriggerAck(member.number, LEADER, burst.number)
    assert orders.take_ack(member, ack) is None
    assert [trigger.count for trigger in triggers_sent(engine)] == [0]
    assert orders.take_ack(member, replace(ack, refusal=CANCELLED)) is None
    assert triggers_sent(engine, NOW_NS + 10**9) == []


def test_a_camera_that_answers_no_trigger_takes_no_part() -> None:
    orders, grid = (engine := engine_of("a")).orders, engine.grid
    burst = orders.place(grid, NOW_NS, BurstOrder(frames=3))
    assert orders.triggers_due(NOW_NS)
    assert orders.expire(NOW_NS + TRIGGER_GIVE_UP_NS - 1) == []
    silent = TriggerAnswered("a", burst.number, NO_ANSWER, is_silent=True)
    assert orders.expire(NOW_NS + TRIGGER_GIVE_UP_NS) == [silent]
    assert orders.triggers_due(NOW_NS + TRIGGER_GIVE_UP_NS) == []


async def test_a_camera_that_sends_nonsense_is_awaited_in_no_burst(tmp_path: Path) -> None:
    async with bursts_of(tmp_path, engine_of("a", "b")) as bursts:
        sessions = [await order(bursts), await order(bursts)]
        await bursts.give_up("a", "it sent an invalid message")
        problems = [{of.camera: of.problem for of in session.status.transfer} for session in sessions]
        assert problems == [{"a": "it sent an invalid message", "b": ""}] * 2


async def test_a_burst_that_could_not_be_written_down_is_forgotten_by_its_nodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While a slow disk writes its plan, the order may leave with other datagrams."""

    async def fail(*_: object) -> None:
        raise DiskFullError("the disk is full", hint="make room")

    engine = engine_of("a", "b")
    async with bursts_of(tmp_path, engine) as bursts:
        monkeypatch.setattr(BurstSession, "write_plan", fail)
        with pytest.raises(DiskFullError):
            await order(bursts)
        assert {t.count for t in triggers_sent(engine)} == {0}
        with pytest.raises(UnwantedImageError):
            await bursts.find_session(replace(report("a", 0, 1), burst=1), "")


async def test_what_was_confirmed_of_a_cancelled_burst_is_kept(tmp_path: Path) -> None:
    engine = engine_of("a", "b")
    async with bursts_of(tmp_path, engine) as bursts:
        session = await order(bursts)
        for name in ("a", "b"):
            await session.accept_report(report(name, 0, 1), NOW_NS)
        await receive_image(session, upload("a", 0), pieces(IMAGE), NOW_NS)
        await bursts.cancel(session.burst.number)
        assert session.session is not None
        manifest = Session.open(session.session).manifest
        assert len(manifest.images) == 1
        assert {gap.reason for gap in manifest.missing} == {"the burst was cancelled"}


async def test_bursts_ahead_are_bounded_keep_nobody_waiting_and_can_be_cancelled(tmp_path: Path) -> None:
    engine = engine_of("a")
    async with bursts_of(tmp_path, engine) as bursts:
        hour_ns = NOW_NS + 3_600 * 10**9
        ahead = [
            await bursts.order(BurstOrder(frames=1, at_leader_ns=hour_ns)) for _ in range(MAX_BURSTS_AHEAD)
        ]
        with pytest.raises(IncompleteError, match="ordered ahead already: 1, 2") as refused:
            await bursts.order(BurstOrder(frames=1, at_leader_ns=hour_ns))
        assert "--cancel" in (refused.value.hint or "")
        now = await order(bursts)
        assert not now.finished.is_set(), "those ahead are not in its way"
        assert bursts.under_way() == [now]
        assert now.status.first_leader_ns == now.burst.instants_ns[0]
        numbers = [session.burst.number for session in ahead]
        assert [burst.burst for burst in bursts.ahead] == numbers
        assert bursts.ahead[0].first_leader_ns == ahead[0].burst.instants_ns[0]
        await bursts.cancel(ahead[0].burst.number)
        assert [burst.burst for burst in bursts.ahead] == numbers[1:]
        again = await bursts.order(BurstOrder(frames=1, at_leader_ns=hour_ns))
        assert again.burst.number > now.burst.number


async def test_a_leader_that_saves_many_bursts_orders_no_further_one(tmp_path: Path) -> None:
    async with bursts_of(tmp_path, engine_of("a")) as bursts:
        saving = [await bursts.order(BurstOrder(frames=1)) for _ in range(MAX_OPEN_BURSTS)]
        with pytest.raises(IncompleteError, match=f"{MAX_OPEN_BURSTS} bursts are still being saved"):
            await bursts.order(BurstOrder(frames=1))
        await bursts.cancel(saving[0].burst.number)
        assert (await bursts.order(BurstOrder(frames=1))).burst.number == MAX_OPEN_BURSTS + 1


@pytest.mark.parametrize("at_ns", [2**70, -(2**70), NOW_NS + 366 * 86_400 * 10**9, 0])
async def test_a_burst_a_year_away_is_refused_and_leaves_nothing(tmp_path: Path, at_ns: int) -> None:
    engine = engine_of("a")
    async with bursts_of(tmp_path, engine) as bursts:
        if at_ns == 0:
            assert (await bursts.order(BurstOrder(frames=1, at_leader_ns=at_ns))).burst.frames == 1
            return
        with pytest.raises(BadInputError, match="is not possible"):
            await bursts.order(BurstOrder(frames=1, at_leader_ns=at_ns))
        assert await asyncio.to_thread(lambda: list(tmp_path.iterdir())) == []
        assert triggers_sent(engine) == []


async def test_a_camera_that_was_silent_once_holds_up_no_further_burst(tmp_path: Path) -> None:
    engine, clock = engine_of("a", "b"), StillClock()
    options = LeaderOptions(sessions=tmp_path, clock=clock, trust=Trust.open())
    bursts = ActiveBursts(options, engine, Pump(engine, clock, lambda: None))

    async def take(*, late: bool = False) -> float:
        """Take a burst to which only one camera brings something; return how many seconds it took."""
        session = await bursts.order(BurstOrder(frames=1, spare=0))
        began_ns, number = clock.shown_ns, session.burst.number
        for name in ("a", "b") if late else ("a",):
            await session.accept_report(replace(report(name, 0), burst=number), clock.shown_ns)
            await receive_image(
                session, replace(upload(name, 0), burst=number), pieces(IMAGE), clock.shown_ns
            )
        session.stream_opened("b")
        while not session.finished.is_set():
            clock.shown_ns += SILENCE_STEP_NS
            await session.give_up_silent_cameras({}, clock.shown_ns)
            # It says again and again that it will bring something.
            if not session.finished.is_set() and clock.shown_ns - began_ns > SILENCE_STEP_NS:
                await session.accept_report(replace(report("b", 0), burst=number), clock.shown_ns)
        await session.finished.wait()
        await asyncio.sleep(0)
        return (clock.shown_ns - began_ns) / 1e9

    try:
        assert 170 < await take() < 200
        assert await take() < 15
        assert await take() < 15
        assert await take(late=True) == 0
        assert 170 < await take() < 200, "it is trusted again"
    finally:
        await bursts.close()


async def test_a_burst_names_the_cameras_that_the_rig_has_lost(tmp_path: Path) -> None:
    engine, clock = engine_of("a", "died", "left", "removed", "without-a-frame"), StillClock()
    options = LeaderOptions(sessions=tmp_path, clock=clock, trust=Trust.open())
    bursts = ActiveBursts(options, engine, Pump(engine, clock, lambda: None))

    async def take() -> BurstSession:
        session = await bursts.order(BurstOrder(frames=1, spare=0))
        number = session.burst.number
        await session.accept_report(replace(report("a", 0), burst=number), clock.shown_ns)
        await receive_image(session, replace(upload("a", 0), burst=number), pieces(IMAGE), clock.shown_ns)
        await session.finished.wait()
        return session

    def hear(name: str, message: FromClient) -> None:
        engine.receive_message(message, (name, 0), clock.shown_ns)

    try:
        for name in ("died", "left", "removed"):
            number = engine.roster.members[name].number
            hear(name, Heartbeat(number, Report(state=NodeState.READY, frames=1)))
        hear("left", Goodbye(engine.roster.members["left"].number))
        for _ in range(12):
            clock.shown_ns += 10**9
            hear("a", TimeRequest(engine.roster.members["a"].number, 0, 0))
            engine.handle_timer(clock.shown_ns)
        engine.forget("removed")
        taken = await take()
        assert taken.status.message == "without died: lost 12 s before"
        assert (taken.status.received, taken.status.expected) == (1, 2), "its command does not exit with 0"
        assert [(of.camera, of.problem) for of in taken.status.transfer] == [
            ("a", ""), ("died", "lost 12 s before")
        ]  # fmt: skip
        manifest = Session.open(taken.folder).manifest
        assert manifest.burst.absent == (AbsentCamera(name="died", reason="lost 12 s before"),)
        again = await asyncio.to_thread(BurstSession.resume, taken.folder, clock.shown_ns, DISK)
        await again.finish_if_complete()
        assert Session.open(taken.folder).manifest.burst == manifest.burst
        clock.shown_ns += FORGET_LOST_NS
        hear("a", Hello("a", 0, CAMERA))
        hear("a", TimeRequest(engine.roster.members["a"].number, 0, 0))
        engine.handle_timer(clock.shown_ns)
        assert (await take()).status.message == "", "it is forgotten"
    finally:
        await bursts.close()


async def test_a_camera_of_the_leader_before_is_missed_until_it_would_be_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with bursts_of(tmp_path, engine_of("a"), awaited=("a", "lost")) as bursts:
        for later_ns, words in (
            (0, "without lost: it has not come back since the leader was lost"),
            (FORGET_LOST_NS, ""),
        ):
            monkeypatch.setattr(StillClock, "shown_ns", NOW_NS + later_ns)
            assert (await order(bursts)).status.message == words


async def test_images_that_come_late_complete_their_session_in_the_same_run(tmp_path: Path) -> None:
    engine, clock = engine_of("a", "b"), StillClock()
    options = LeaderOptions(sessions=tmp_path, clock=clock, trust=Trust.open())
    bursts = ActiveBursts(options, engine, Pump(engine, clock, lambda: None))

    def shown(session: BurstSession) -> Verdict:
        opened = Session.open(session.folder)
        return judge(opened.manifest, arriving=opened.is_arriving)

    try:
        session = await bursts.order(BurstOrder(frames=1, spare=0))
        number = session.burst.number
        told = {name: replace(report(name, 0), burst=number) for name in ("a", "b")}
        await session.accept_report(told["a"], clock.shown_ns)
        await receive_image(session, replace(upload("a", 0), burst=number), pieces(IMAGE), clock.shown_ns)
        clock.shown_ns += 2 * AFTER_LAST_INSTANT_NS + CAMERA_DISCONNECTED_NS
        await bursts.give_up_silent_cameras()
        assert shown(session).grade == "poor", "a camera that is away may never come back"
        # It has waited for its network, and comes back.
        late = await bursts.find_session(told["b"], "")
        assert isinstance(late, BurstSession)
        late.stream_opened("b")
        await late.accept_report(told["b"], clock.shown_ns)
        assert bursts.newest is late
        status = late.status
        assert (status.burst, status.received, status.expected, status.done) == (number, 1, 2, False)
        assert status.message == "1 arriving"
        assert status.session == str(session.folder), "which is how the screen knows that it is open again"
        assert shown(session).grade != "poor"
        assert shown(session).headline.endswith("1 of 2 images, 1 arriving")
        (card,) = list_sessions(tmp_path)
        assert (card.missing, card.arriving) == (1, True)
        (result,) = await repair(tmp_path, wait_s=0, address=Address("127.0.0.1", 0), log=Log())
        assert (result.ok, result.missing) == (True, 1)
        assert result.awaited == ("b",)
        await receive_image(late, replace(upload("b", 0), burst=number), pieces(IMAGE), clock.shown_ns)
        assert (late.status.done, late.status.message, late.status.received) == (True, "", 2)
        assert "all 2 images there" in shown(session).headline
        (card,) = list_sessions(tmp_path)
        assert (card.missing, card.arriving) == (0, False)
    finally:
        await bursts.close()


async def test_a_take_that_no_camera_has_confirmed_is_kept_for_their_images(tmp_path: Path) -> None:
    """The network was away when they answered; they have their frames."""
    engine = engine_of("a")
    async with bursts_of(tmp_path, engine) as bursts:
        session = await order(bursts, frames=2)
        bursts.note_answer(TriggerAnswered("a", session.burst.number, "silent for 2 s", is_silent=True))
        await session.finished.wait()
        late = await bursts.find_session(replace(report("a", 0, 1), burst=session.burst.number), "")
        assert isinstance(late, BurstSession)
        assert late.folder == session.folder


async def test_a_take_waits_in_the_queue_of_a_camera_that_is_busy_with_an_earlier_one(tmp_path: Path) -> None:
    """A slow link: an image takes 40 s, and what stands behind it is neither reported nor given up."""
    engine, clock = engine_of("a", "b"), StillClock()
    options = LeaderOptions(sessions=tmp_path, clock=clock, trust=Trust.open())
    bursts = ActiveBursts(options, engine, Pump(engine, clock, lambda: None))
    large = small_jpeg(bytes(40 * MIN_UPLOAD_BYTES_PER_S - len(small_jpeg())))

    async def deliver(session: BurstSession, name: str, data: AsyncIterator[bytes], image: bytes) -> None:
        number = session.burst.number
        session.stream_opened(name)
        await session.accept_report(replace(report(name, 0), burst=number), clock.shown_ns)
        sent = replace(upload(name, 0), burst=number)
        sha256 = hashlib.sha256(image).hexdigest()
        sent = replace(sent, record=replace(sent.record, bytes=len(image), sha256=sha256))
        await receive_image(session, sent, data, clock.shown_ns)

    async def slowly() -> AsyncIterator[bytes]:
        for begin in range(0, len(large), MIN_UPLOAD_BYTES_PER_S):
            yield large[begin : begin + MIN_UPLOAD_BYTES_PER_S]
            clock.shown_ns += 10**9
            await bursts.give_up_silent_cameras()

    try:
        takes = [await bursts.order(BurstOrder(frames=1, spare=0)) for _ in range(3)]
        clock.shown_ns += 3 * 10**9
        for take in takes:
            await deliver(take, "b", pieces(IMAGE), IMAGE)
        for take in takes:
            assert not take.finished.is_set(), "it stands in the queue of a camera that is at work"
            await deliver(take, "a", slowly(), large)
            await take.finished.wait()
        assert [take.status.message for take in takes] == ["", "", ""]
        silent = await bursts.order(BurstOrder(frames=1, spare=0))
        clock.shown_ns += 13 * 10**9
        await deliver(silent, "b", pieces(IMAGE), IMAGE)
        await bursts.give_up_silent_cameras()
        assert silent.status.message == "1 image missing (a: it sent nothing)", "it is not busy any more"
    finally:
        await bursts.close()


SILENCE_STEP_NS = 500_000_000


async def test_the_recording_that_was_begun_last_ends_without_a_number(tmp_path: Path) -> None:
    async with bursts_of(tmp_path, engine_of("a")) as bursts:
        first, second = [await bursts.order(BurstOrder(frames=1000, streamed=True)) for _ in range(2)]
        await bursts.end()
        assert (first.burst.frames, second.burst.frames < 1000) == (1000, True)


async def test_a_camera_that_missed_the_end_of_a_recording_is_told_again(tmp_path: Path) -> None:
    engine, clock = engine_of("a"), StillClock()
    options = LeaderOptions(sessions=tmp_path, clock=clock, trust=Trust.open())
    bursts = ActiveBursts(options, engine, Pump(engine, clock, lambda: None))
    try:
        session = await bursts.order(BurstOrder(frames=1000, streamed=True, video=True))
        taking = replace(report("a").with_plan(picking=True), burst=session.burst.number)
        await session.accept_report(taking, clock.shown_ns)
        await bursts.end()
        clock.shown_ns += 10 * 10**9
        engine.orders.expire(clock.shown_ns)
        assert engine.orders.triggers_due(clock.shown_ns) == []
        await bursts.give_up_silent_cameras()
        ((members, trigger),) = engine.orders.triggers_due(clock.shown_ns)
        assert [member.name for member in members] == ["a"]
        assert (trigger.burst, trigger.count) == (session.burst.number, session.burst.frames)
    finally:
        await bursts.close()


async def test_a_disk_that_begins_to_hang_has_no_known_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def hang(_: ActiveBursts) -> None:
        await asyncio.Event().wait()

    async with bursts_of(tmp_path, engine_of("a")) as bursts:
        await bursts.look_at_disk()
        assert bursts.free_bytes
        monkeypatch.setattr(ActiveBursts, "_look", hang)
        monkeypatch.setattr(StillClock, "shown_ns", NOW_NS + leader_bursts.LOOK_EVERY_NS)
        await bursts.look_at_disk()
        assert bursts.free_bytes is None


async def test_a_take_that_gets_late_images_is_not_the_newest_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with bursts_of(tmp_path, engine_of("a", "b")) as bursts:
        first = await bursts.order(BurstOrder(frames=1, spare=0))
        told = {name: replace(report(name, 0), burst=first.burst.number) for name in ("a", "b")}
        await first.accept_report(told["a"], NOW_NS)
        await receive_image(first, replace(upload("a", 0), burst=first.burst.number), pieces(IMAGE), NOW_NS)
        later_ns = NOW_NS + 2 * AFTER_LAST_INSTANT_NS + CAMERA_DISCONNECTED_NS
        monkeypatch.setattr(StillClock, "shown_ns", later_ns)
        await bursts.give_up_silent_cameras()
        second = await bursts.order(BurstOrder(frames=1, spare=0))
        late = await bursts.find_session(told["b"], "")
        assert isinstance(late, BurstSession)
        await late.accept_report(told["b"], later_ns)
        assert (late.folder, bursts.newest) == (first.folder, second)

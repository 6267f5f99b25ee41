"""What a node makes of its engine's events: for whom its images are, what its reports say, what it logs."""

import asyncio
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from msgspec.structs import replace

from capture_app.common.address import Address
from capture_app.common.camera_facts import StampAccuracy, StampSource
from capture_app.node.camera.camera_node import CameraNode, widened_times
from capture_app.node.camera.device_profiles import DeviceProfiles, link_key, node_key
from capture_app.node.camera.spool import Spool
from capture_app.node.camera.supervisor import CameraSupervisor, NodeOptions
from capture_app.protocol.log import Log
from capture_app.protocol.orders import SaveStamp
from capture_app.session.format.manifest import PhaseMove
from capture_app.sync.clock.clock_filter import ClockSample, PathAsymmetry
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.events import FramesDropped, LeaderNotice, PhaseMoved, TriggerCancelled
from capture_app.sync.rig.frame_selection import FramesSelected, SelectedFrame
from capture_app.sync.timekeeping.clock_events import TimesDoubted
from capture_app.sync.wire.codec import encode
from capture_app.sync.wire.datagrams import JoinRefusal, RigConfigMessage, Trigger, Welcome
from capture_app.trust.trust import Trust
from tests.unit.cameras.fake_camera import FACTS, FakeCamera, frame
from tests.unit.node.camera.uploading import Picture, burst_upload
from tests.waiting import until

FIRST, SECOND = Address("10.0.0.1", 47010), Address("10.0.0.2", 47010)
WEBCAM = replace(FACTS, kind="webcam")
INSTANCE, LEADER, TRANSFER_PORT = 7, 3, 48000
CONFIG = RigConfigMessage(leader=LEADER, anchor_leader_ns=0, period_ns=FACTS.period_ns)
MAP = TimeMap(0, 0, 0.0, 10_000.0, 50_000.0, 1e-6, 2e-6, 300, 1_000_000)
STEP = TimesDoubted(0, 500, 10**9, 2 * 10**9, jumped=True)


class Node(CameraNode):
    """A node whose datagrams, frames and uploads are the test's."""

    def __init__(self, folder: Path) -> None:
        self.said: list[str] = []
        super().__init__(
            NodeOptions(
                name="cam",
                open_camera=lambda: FakeCamera(WEBCAM),
                leaders=(FIRST, SECOND),
                trust=Trust.open(),
                log=Log(self.said.append),
                profiles=DeviceProfiles(folder),
            )
        )
        self.uploads = self._uploader = Mock(problem="", is_busy=False, spool=None)

    async def prepare(self) -> None:
        self._camera = CameraSupervisor(self.options)
        await self._camera.open()
        self._prepare(INSTANCE, (FIRST, SECOND))
        self._viewfinder.set_leader = Mock()  # type: ignore[method-assign]
        self.watched = self._viewfinder.set_leader

    def happen(self, *events: Any) -> None:
        self._engine._events.extend(events)
        self._drain(self._clock.now_ns())

    def join(self) -> None:
        """Say hello to the first leader, and be welcome."""
        now_ns = self._clock.now_ns()
        self._failover.handle_timer(now_ns)
        assert [address for _, address in self._failover.datagrams_to_send(now_ns)] == [FIRST]
        self._failover.receive_datagram(encode(Welcome(INSTANCE, 5, TRANSFER_PORT, CONFIG)), FIRST, now_ns)
        self._drain(now_ns)

    def added(self) -> Any:
        """Return the upload that was begun last."""
        return self.uploads.add_burst.call_args.args[0]


@pytest.fixture
async def node(tmp_path: Path) -> Node:
    node = Node(tmp_path)
    await node.prepare()
    return node


def selected(*, local_ns: int = 100, burst: int = 1, further: bool = False) -> FramesSelected[Any]:
    trigger = Trigger(5, LEADER, burst, 0, 1000, 2, streamed=True)
    picks = (SelectedFrame(0, local_ns, local_ns, 0, 1, 2, 0, frame(0, local_ns)),)
    return FramesSelected(trigger, picks, (), MAP, None, further=further, over=1)


async def test_images_and_previews_are_for_the_leader_that_is_joined(node: Node, tmp_path: Path) -> None:
    asymmetry = PathAsymmetry(5, 9.0, 70)
    for host, of in (("10.0.0.1", asymmetry), ("10.0.0.2", PathAsymmetry(1, 1.0, 70))):
        DeviceProfiles(tmp_path).save(link_key("cam", host), asymmetry=of)
    node._samples.append(ClockSample(1, 2, 3, 4))
    node.join()
    port = Address("10.0.0.1", TRANSFER_PORT)
    node.uploads.set_leader.assert_called_once_with(port, LEADER)
    node.watched.assert_called_once_with(port)
    assert not node._samples, "they are of another leader's clock"
    assert node._engine.timekeeper.clock.asymmetry == asymmetry
    assert f"joined {port}" in node.said


async def test_a_report_has_what_happened_since_the_last_one(node: Node) -> None:
    node.happen(FramesDropped(2, 40), LeaderNotice("said", "two are called cam"), selected())
    first = node.added().report
    assert [event["event"] for event in first.events] == ["frames-dropped", "leader-said"]
    assert (first.leader, first.burst, first.plan.camera.name) == (LEADER, 1, "cam")
    assert first.plan.picking
    node.happen(FramesDropped(1, 50), selected(burst=2), selected(burst=2, further=True))
    second = node.added().report
    assert [(event["event"], event["count"]) for event in second.events] == [("frames-dropped", 1)]
    node.uploads.extend_burst.assert_called_once()
    assert any("two are called cam" in line for line in node.said)


async def test_frames_from_before_a_step_of_the_clock_are_doubted_however_late_they_come(node: Node) -> None:
    later = TimesDoubted(600, 700, 5, 6, jumped=False)
    node.happen(STEP, later)
    told = [call.args[0] for call in node.uploads.widen_times.call_args_list]
    assert told == [widened_times(STEP), widened_times(later)]
    node.happen(selected(local_ns=500))
    (widened,) = node.added().report.plan.camera.widened
    assert (widened.from_local_ns, widened.until_local_ns, widened.hard_bound_ns) == (
        500,
        500,
        STEP.hard_bound_ns,
    )
    node.happen(selected(local_ns=501, burst=2))
    assert not node.added().report.plan.camera.widened


async def test_a_cancelled_burst_and_a_move_of_the_stream_are_for_its_uploads(node: Node) -> None:
    node.happen(TriggerCancelled(LEADER, 4), PhaseMoved(70, 8))
    node.uploads.cancel_burst.assert_called_once_with(LEADER, 4)
    node.uploads.note_move.assert_called_once_with(PhaseMove(local_ns=70, shift_ns=8))


async def test_a_state_and_its_reason_are_logged_once(node: Node) -> None:
    node._failover.receive_datagram(encode(JoinRefusal(INSTANCE, "the rig is full")), FIRST, 0)
    for _ in range(3):
        node.happen()
    assert sum(line.startswith("joining") for line in node.said) == 1
    assert node.standing == ("joining", "the rig is full")
    node.uploads.problem = "the leader's disk is full"
    node.happen()
    assert node._engine.upload_problem == "the leader's disk is full"


async def test_a_measured_stamp_holds_at_once_and_in_later_runs(node: Node, tmp_path: Path) -> None:
    stamp = StampAccuracy(
        bias_ns=3000, uncertainty_ns=10, source=StampSource.LIGHT, exposure_ns=FACTS.exposure_ns
    )
    answer = node._viewfinder.save_stamp(SaveStamp(camera="cam", stamp=stamp))
    assert answer.is_stored
    assert node._camera.facts.stamp == node._engine.camera.stamp == stamp
    again = Node(tmp_path)
    await again.prepare()
    assert again._camera.facts.stamp == stamp


async def test_leaders_that_were_followed_are_stored_under_the_nodes_name(node: Node, tmp_path: Path) -> None:
    node._joining._remember({"key": (FIRST,)})
    assert DeviceProfiles(tmp_path).read(node_key("cam")).followed == {"key": (FIRST,)}


async def test_details_are_by_the_clocks_rate_and_the_rigs_instants(node: Node) -> None:
    node.join()
    node._engine.timekeeper.time_map = TimeMap(0, 0, 30e-6, 1.0, 2.0, 0.0, 0.0, 3, 4)
    node._samples.extend(ClockSample(at, at + 5, at + 5, at) for at in (0, 10**9))
    assert node._viewfinder.detail().samples == ((30_005, 0), (5, 0))


@pytest.mark.virtual
async def test_a_node_that_ends_lets_go_of_its_camera_and_its_spool(tmp_path: Path) -> None:
    camera, spool = FakeCamera(), tmp_path / "spool"
    options = NodeOptions(
        name="a",
        open_camera=lambda: camera,
        leaders=(Address("127.0.0.1", 47010),),
        trust=Trust.open(),
        spool=spool,
        profiles=DeviceProfiles(tmp_path),
    )
    node = CameraNode(options)
    running = asyncio.create_task(node.run())
    await until(lambda: hasattr(camera, "on_frame"))
    node._uploader.add_burst(burst_upload(Picture(b"zero"), Picture(b"one")))
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert camera.is_stopped
    again = Spool(spool, "a")
    (burst,) = again.open()
    assert burst.read_report().burst == burst_upload().report.burst
    again.close()

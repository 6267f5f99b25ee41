"""A rig for tests of the screen: it is as the test says, and keeps what was asked of it."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Mapping
from copy import copy
from typing import Any

import cv2
import msgspec
import numpy as np

from capture_app.common.address import Address
from capture_app.common.bounds import Message
from capture_app.common.camera_facts import Control, ControlValue, PhaseControl
from capture_app.common.errors import NoCameraHereError, SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.protocol import orders
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.pairing_messages import Invited
from capture_app.protocol.status import (
    BurstStatus,
    CameraTransfer,
    LogLine,
    NodeDetail,
    NodeStatus,
    Preview,
    RigStatus,
)
from capture_app.rig.motion_watch import LEARN
from capture_app.rig.rig_link import A, CamerasControls, LinkLost, RigLink, Update
from capture_app.rig.rig_time import PlacedMark
from capture_app.session.format.marks import Mark
from tests.facts import make_facts

PERIOD_NS = 33_333_000
UNIX_NS = 1_700_000_000_000_000_000
HOUR_NS = 3_600_000_000_000


def make_node(name: str, state: NodeState = NodeState.READY, **different: Any) -> NodeStatus:
    """A camera of a rig: ready and 12 µs late, but for what is given."""
    plain: dict[str, Any] = {
        "address": "192.168.1.7:50112",
        "camera": make_facts(model="Simulated phone A", phase_control=PhaseControl.INJECTION),
        "offset_ns": 4 * HOUR_NS,
        "hard_bound_ns": 61_000,
        "uncertainty_ns": 9_000,
        "round_trip_ns": 122_000,
        "samples": 412,
        "phase_error_ns": 12_400,
        "tolerance_ns": 100_000,
        "period_ns": PERIOD_NS,
        "frames": 900,
        "fps": 30.0,
        "exposure_ns": 10_000_000,
        "gain": 1.5,
        "disk_free_bytes": 34_000_000_000,
    }
    return NodeStatus(name=name, state=state, **plain | different)


def make_rig(cameras: int) -> tuple[NodeStatus, ...]:
    """So many cameras: nearly all ready, the last ones on their way, failed and lost."""
    nodes = [make_node(f"cam{n:02d}", phase_error_ns=(n * 37 % 90 - 45) * 1000) for n in range(cameras)]
    if cameras >= 5:
        syncing = {"phase_error_ns": None, "offset_ns": None, "hard_bound_ns": None, "uncertainty_ns": None}
        nodes[-3] = make_node(nodes[-3].name, NodeState.ALIGNING, phase_error_ns=7_310_000)
        nodes[-2] = make_node(nodes[-2].name, NodeState.SYNCING, **syncing)
        nodes[-1] = make_node(nodes[-1].name, NodeState.LOST, drops=3, last_seen_ns=42_000_000_000)
    return tuple(nodes)


def show_motion(rig: "FakeRig", *, leader_ns: int) -> None:
    """Let a camera show a still scene until it is known, and then something that was not there."""
    still = np.full((48, 64), 90, np.uint8)
    moved = still.copy()
    moved[10:30, 10:30] = 200
    for picture in (*[still] * (LEARN + 1), moved):
        jpeg = cv2.imencode(".jpg", picture)[1].tobytes()
        rig.tell(Preview(camera="cam01", leader_ns=leader_ns, width=64, height=48, jpeg=jpeg))


class FakeRig(RigLink):
    """A link without a network: `nodes` are its cameras, `asked` what it was told to do, in order."""

    def __init__(self, cameras: int = 0) -> None:
        super().__init__(Address("127.0.0.1", 47010))
        self.nodes = make_rig(cameras)
        self.asked: list[tuple[object, ...]] = []
        self.failure: SimulshotError | None = None
        self.phones_failure: SimulshotError | None = None
        """Raised by the next order."""
        self.take: Callable[[BurstRequest], Awaitable[str | None]] | None = None
        """Makes the session of a burst, and returns its path."""
        self.is_ready: asyncio.Event | None = None
        """A burst that waits for the rig waits for this."""
        self.saves: asyncio.Event | None = None
        """The images of a burst come when this is set."""
        self.is_recording = False
        """The next take is a recording, which lasts until `saves` is set."""
        self.breaks_off: SimulshotError | None = None
        """The connection is lost with this after the first image of the next burst, which goes on."""
        self.is_lost = False
        self.details: dict[str, NodeDetail] = {}
        self.detail_failure: SimulshotError | None = None
        self.phones_come = 0
        self.matched: CamerasControls = {}
        """What comes of setting all cameras like one."""
        self.different: dict[str, Any] = {}
        """Fields of the status that are not as usual."""
        self.burst_status: BurstStatus | None = None
        self.told = 0
        self._updates: asyncio.Queue[Update] = asyncio.Queue()
        self._others: list[asyncio.Queue[Update]] = []

    def status(self) -> RigStatus:
        plain: dict[str, Any] = {
            "leader": "192.168.1.5:47010",
            "now_ns": 0,
            "period_ns": PERIOD_NS if self.nodes else None,
            "sessions_folder": "/home/ada/sessions",
            "disk_free_bytes": 112_000_000_000,
        }
        return RigStatus(nodes=self.nodes, burst=self.burst_status, **plain | self.different)

    # What a test does to it

    def change(self, name: str, **different: Any) -> None:
        """Let a camera be otherwise, and tell."""
        self.nodes = tuple(
            msgspec.structs.replace(node, **different) if node.name == name else node for node in self.nodes
        )
        self.tell()

    def tell(self, update: Update | None = None) -> None:
        """Tell the screen an update; the present status where none is given."""
        for link in (self._updates, *self._others):
            link.put_nowait(self.status() if update is None else update)

    def news(self, text: str, **more: Any) -> None:
        """Tell the screen a line of news, a second after the last."""
        self.told += 1
        self.tell(LogLine(unix_ns=UNIX_NS + self.told * 1_000_000_000, text=text, **more))

    def lose_link(self, reason: str = "192.168.1.5:47010 does not answer") -> None:
        """Let the leader be gone."""
        self.tell(LinkLost(reason))

    def preview(self, camera: str, jpeg: bytes, width: int, height: int) -> None:
        """Let a camera show a picture."""
        self.tell(Preview(camera=camera, leader_ns=0, width=width, height=height, jpeg=jpeg))

    def is_heard(self) -> bool:
        """Whether the other links have got all updates."""
        return not any(link.qsize() for link in self._others)

    def another(self) -> "FakeRig":
        """A second link: it tells what this one is told to tell from now on."""
        link = copy(self)
        link._updates = asyncio.Queue()
        self._others.append(link._updates)
        return link

    # What the screen asks of it

    async def updates(self) -> AsyncGenerator[Update, None]:
        if not self.is_lost:
            yield self.status()
        while True:
            yield await self._updates.get()

    async def mark(self, text: str) -> PlacedMark:
        self._ask("mark", text)
        mark = Mark(text=text, leader_ns=5_000_000_000, uncertainty_ns=100_000)
        return PlacedMark(mark=mark, sessions=("burst-001",), file="")

    async def want_previews(self, *, cameras: tuple[str, ...] | None, width: int, fps: float) -> None:
        self.asked.append(("want_previews", cameras, width, fps))

    async def burst(self, request: BurstRequest) -> AsyncIterator[BurstStatus]:
        self._ask("burst", request)
        here = [node for node in self.nodes if node.state is not NodeState.LOST]
        if not here:
            raise NoCameraHereError("no camera is here")
        number = sum(order[0] == "burst" for order in self.asked)
        name = f"{request.name or 'burst'}-{number:03d}"
        frames = request.frames or int(self.is_recording)
        if self.is_ready is not None and request.wait_ready_s:
            yield BurstStatus(
                burst=0,
                name="",
                message="waiting for the rig: cam01 is aligning",
                cameras=0,
                instants=0,
                received=0,
                expected=0,
            )
            await self.is_ready.wait()
            self._fail()
        session = await self.take(request) if self.take else None
        for received in range(frames + 1):
            transfer = tuple(
                CameraTransfer(camera=node.name, received=received, expected=frames) for node in here
            )
            self.burst_status = BurstStatus(
                burst=number,
                name=name,
                cameras=len(here),
                instants=frames,
                received=received * len(here),
                expected=frames * len(here),
                done=received == frames,
                session=session if received == frames else None,
                transfer=transfer,
            )
            yield self.burst_status
            if received and self.breaks_off is not None:
                error, self.breaks_off, self.is_lost = self.breaks_off, None, True
                raise error
            self.tell()
            if self.saves is not None:
                await self.saves.wait()

    async def order(self, order: orders.Order) -> None:
        self._ask("order", order)
        match order:
            case orders.AddSimulated(cameras=cameras):
                self.add_cameras(cameras)
            case orders.RemoveCamera(name=name):
                self.nodes = tuple(node for node in self.nodes if node.name != name)
                self.tell()

    def add_cameras(self, cameras: int) -> None:
        """Let so many more be here, whose clocks are not known yet."""
        new = {"phase_error_ns": None, "hard_bound_ns": None, "on_leader": True}
        first = len(self.nodes)
        self.nodes += tuple(
            make_node(f"cam{first + n:02d}", NodeState.SYNCING, **new) for n in range(cameras)
        )
        self.tell()

    async def ask(self, request: Message, kind: type[A]) -> A:
        answer: Message
        match request:
            case orders.DetailRequest(camera=name):
                if self.detail_failure is not None:
                    raise self.detail_failure
                detail = self.details.get(name, NodeDetail(camera=name))
                answer = detail
            case orders.InvitePhone():
                if self.phones_failure is not None:
                    raise self.phones_failure
                secret = f"https://192.168.1.20:47011/#{self.phones_come:022d}"
                answer = orders.PhoneInvited(url=secret, fingerprint=":".join(["A7"] * 32), good_for_s=600)
            case _:
                answer = Invited(code="12345678", good_for_s=600)
        if not isinstance(request, orders.DetailRequest):
            self._ask("ask", request)
        assert isinstance(answer, kind)
        return answer

    async def match_cameras(self, source: str) -> CamerasControls:
        self._ask("match_cameras", source)
        return self.matched

    async def set_camera(self, camera: str, values: Mapping[Control, ControlValue]) -> CamerasControls:
        self._ask("set_camera", camera, values)
        return self.matched

    def _ask(self, *order: object) -> None:
        self.asked.append(order)
        self._fail()

    def _fail(self) -> None:
        if self.failure is not None:
            failure, self.failure = self.failure, None
            raise failure

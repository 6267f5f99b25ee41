"""A camera with controls that a test looks at, and that chooses what the test wants."""

from dataclasses import dataclass
from typing import Any, cast

from msgspec.structs import replace

from capture_app.cameras.base import Camera, OnFailure, OnFrame
from capture_app.common.camera_facts import KELVIN, MICROSECONDS, CameraFacts, Control, ControlState, steps_of
from capture_app.common.clock import HostClock
from capture_app.common.errors import CameraError
from capture_app.node.camera.supervisor import CameraSupervisor, ControlKeeper, NodeOptions
from capture_app.node.camera.viewfinder import Viewfinder
from capture_app.protocol.orders import SaveStamp, StampSaved
from capture_app.protocol.status import NodeDetail
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.wire.camera_commands import CameraCommand
from tests.facts import make_facts

EXPOSURE = ControlState(
    control=Control.EXPOSURE,
    value=4000.0,
    unit=MICROSECONDS,
    automatic=True,
    can_be_automatic=True,
    minimum=100.0,
    maximum=30_000.0,
)
GAIN = ControlState(control=Control.GAIN, value=7.0, unit=steps_of("A"), minimum=0.0, maximum=15.0)
WHITE_BALANCE = ControlState(control=Control.WHITE_BALANCE, value=5000.0, unit=KELVIN)
"""It tells this one, and takes none."""


class ControlledCamera(Camera):
    """Exposes automatically until it is set."""

    def __init__(self, *states: ControlState) -> None:
        self.states = {state.control: state for state in states or (EXPOSURE, GAIN, WHITE_BALANCE)}
        self.refuses = self.refuses_to_set = False
        self.set: list[tuple[Control, float | None]] = []

    @property
    def facts(self) -> CameraFacts:
        state = self.states.get(Control.EXPOSURE)
        known = state is not None and not state.automatic and state.value is not None
        return make_facts(exposure_ns=round((state.value or 0) * 1000) if known and state else None)

    def choose(self, value: float) -> None:
        """Let the camera choose another exposure, if it does."""
        if self.states[Control.EXPOSURE].automatic:
            self.states[Control.EXPOSURE] = replace(self.states[Control.EXPOSURE], value=value)

    async def controls(self) -> tuple[ControlState, ...]:
        if self.refuses:
            raise CameraError("the device is gone")
        return tuple(self.states.values())

    async def set_control(self, control: Control, value: float | None) -> None:
        if self.refuses or self.refuses_to_set:
            raise CameraError("the device is gone")
        self.set.append((control, value))
        before = self.states[control]
        self.states[control] = replace(
            before, value=before.value if value is None else value, automatic=value is None
        )

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        pass

    async def apply(self, command: CameraCommand) -> None:
        pass

    async def stop(self) -> None:
        pass


@dataclass
class Holder:
    """Holds an open camera, as its supervisor does, and counts how often it may expose otherwise."""

    camera: Camera
    changes: int = 0

    def note_exposure(self) -> None:
        self.changes += 1


def keeper_of(camera: Camera) -> ControlKeeper:
    return ControlKeeper(cast(CameraSupervisor, Holder(camera)))


class StillClock(HostClock):
    """Shows one second for ever."""

    def now_ns(self) -> int:
        return 1_000_000_000


class Shown(Viewfinder):
    """A viewfinder whose node stores nothing, and says itself whether it is busy."""

    def __init__(self, node: "ShownNode", instance: int) -> None:
        part: Any = node
        super().__init__(node.options, instance, part, part, part, ())
        self._node = node

    @property
    def is_busy(self) -> bool:
        return self._node.is_busy

    def detail(self) -> NodeDetail:
        return NodeDetail(camera=self._node.options.name, samples=((5, 6),))

    def save_stamp(self, measured: SaveStamp) -> StampSaved:
        return StampSaved(camera=self._node.options.name, is_stored=False)


class ShownNode:
    """A viewfinder, and what a node around it would be, whose leader's clock is 7 ns ahead."""

    def __init__(self, name: str, instance: int, camera: Camera) -> None:
        self.options = NodeOptions(name=name, open_camera=lambda: camera, leaders=(), clock=StillClock())
        self.camera, self.is_busy = camera, False
        self.grid: FrameGrid | None = FrameGrid(0, 20_000_000)
        self.controls = keeper_of(camera)
        self.viewfinder = Shown(self, instance)

    # As the engine

    @property
    def time_map(self) -> "ShownNode":
        return self

    def leader_from_local(self, local_ns: int) -> int:
        return local_ns + 7

    def instant_of(self, stamp_ns: int) -> tuple[int, FrameGrid, int] | None:
        """On a grid of 20 ms, unless the test has taken it away."""
        return None if self.grid is None else (self.grid.index_of(stamp_ns + 7), self.grid, 0)

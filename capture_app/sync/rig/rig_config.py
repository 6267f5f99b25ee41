"""Configuration of a rig: the leader's options, and the current values that it sends to its clients."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.grouping import grouped
from capture_app.common.node_state import WITHOUT_CAMERA
from capture_app.common.stagger import Stagger
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.phase.grid_phase_choice import GridPhaseChoice
from capture_app.sync.phase.period_choice import can_hold, choose_period
from capture_app.sync.rig.roster import Member
from capture_app.sync.wire.datagrams import MAX_DELAYS, RigConfigMessage, UpstreamMap, camera_key


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestedConfig:
    """Requested alignment of a rig's frames, and how long a burst may wait for it."""

    period_ns: int | None = None
    """Frame period; None: the period of most cameras."""
    align_row: float | None = None
    """Row whose middle of exposure is aligned, as a fraction of the height; None for the first row's
    start.
    """
    stagger: Stagger | None = None
    """Planned order of the cameras' frames; None: all at the same instant."""


@dataclass(slots=True)
class CurrentConfig:
    """Current configuration that a leader sends to all its clients."""

    leader: int
    """Instance number of the leader."""
    config: RequestedConfig
    grid_choice: GridPhaseChoice | None = None
    upstream: UpstreamMap | None = None
    """Map from a relay's clock to the root's; clients chain it to their estimates."""
    in_holdover: bool = False
    """Whether a relay has no leader at present, or its leader is in holdover."""
    continues: UpstreamMap | None = None
    """Map from the root's time to the time of the leader that it replaced."""
    grid_is_of_cameras: bool = False
    """Whether the grid has a camera's period or the requested one, and keeps it."""
    delays_ns: Mapping[int, int] | None = field(default_factory=dict)
    """Planned delays of staggered cameras by `camera_key`; None: cameras keep theirs, as after a takeover."""

    @property
    def grid(self) -> FrameGrid | None:
        """Grid of instants that all cameras are moved onto; None before the first client."""
        return None if self.grid_choice is None else self.grid_choice.grid

    def lay_grid(self, camera: CameraFacts, now_ns: int) -> bool:
        """Create the grid with the period of the first camera; return whether it has changed."""
        is_camera = camera.kind not in WITHOUT_CAMERA
        if self.grid_choice is not None and (self.grid_is_of_cameras or not is_camera):
            return False
        self.grid_is_of_cameras = is_camera or self.config.period_ns is not None
        grid = FrameGrid(now_ns, self.config.period_ns or camera.period_ns)
        if self.grid_choice is not None and grid.period_ns == self.grid_choice.grid.period_ns:
            return False
        self.grid_choice = GridPhaseChoice(grid)
        return True

    def is_held(self, camera: CameraFacts) -> bool:
        """Whether a camera can be held on the current grid."""
        grid = self.grid
        return grid is not None and can_hold(camera.period_ns, grid.period_ns)

    def follow_cameras(self, cameras: Sequence[Member], now_ns: int) -> bool:
        """Create the grid again if another period suits these cameras better; return whether it has changed.

        Each machine has one vote. Without any camera the next one determines the grid.
        """
        grid = self.grid
        if grid is None or self.config.period_ns is not None or not self.grid_is_of_cameras:
            return False
        if not cameras:
            self.grid_is_of_cameras = False
            return False
        machines = grouped((camera.machine, camera.camera.period_ns) for camera in cameras)
        if (best_ns := choose_period(grid.period_ns, machines.values())) == grid.period_ns:
            return False
        self.grid_choice = GridPhaseChoice(FrameGrid(now_ns, best_ns))
        return True

    @property
    def is_staggered(self) -> bool:
        """Whether cameras have planned delays, or will have some, or are still to lose them."""
        return self.config.stagger is not None or bool(self.delays_ns)

    def message(self, poll_interval_ns: int, cameras: Collection[str] = ()) -> RigConfigMessage:
        """Return the message to a client, whose time requests are `poll_interval_ns` apart on average.

        It has the planned delays of these `cameras`, of MAX_DELAYS at most: of the client's own, or of all
        below a relay.
        """
        assert self.grid_choice is not None, "the first hello sets the grid"
        grid = self.grid_choice.grid
        delays_ns = self.delays_ns or {}
        planned = ((key, delays_ns[key]) for key in map(camera_key, cameras) if delays_ns.get(key))
        return RigConfigMessage(
            leader=self.leader,
            anchor_leader_ns=grid.anchor_leader_ns,
            period_ns=grid.period_ns,
            align_row=self.config.align_row,
            common_instant_leader_ns=self.grid_choice.common_instant_leader_ns,
            poll_interval_ns=poll_interval_ns,
            upstream=self.upstream,
            in_holdover=self.in_holdover,
            continues=self.continues,
            delays_ns=None if self.delays_ns is None else dict(islice(planned, MAX_DELAYS)),
        )

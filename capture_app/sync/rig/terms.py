"""A leader's own terms, alike for all its clients: the grid of instants and the way to the root's time."""

from collections.abc import Iterable
from dataclasses import dataclass

from capture_app.camera_facts import CameraFacts
from capture_app.sync.phase.aligner import HOPELESS_PPM
from capture_app.sync.phase.goal import Goal
from capture_app.sync.phase.shared_goal import SharedGoal
from capture_app.sync.wire.messages import WITHOUT_CAMERA, Terms
from capture_app.sync.wire.upstream_map import UpstreamMap


@dataclass(slots=True)
class RigTerms:
    """A leader's own terms, as they are at present."""

    leader: int
    """Its run."""
    period_ns: int | None
    """The rig's, where it was asked for; None where the first camera sets it."""
    align_row: float | None
    shared_goal: SharedGoal | None = None
    upstream: UpstreamMap | None = None
    """Of a relay: from its clock to the root's; clients chain it to their estimates."""
    in_holdover: bool = False
    """Of a relay: it has no leader at present, or that one is in holdover."""
    grid_is_of_cameras: bool = False
    """Whether the grid has the period of a camera, or the one asked for, and keeps it."""

    @property
    def goal(self) -> Goal | None:
        """The grid of instants that all cameras are moved onto; None before the first client."""
        return None if self.shared_goal is None else self.shared_goal.goal

    def lay_grid(self, camera: CameraFacts, now_ns: int) -> bool:
        """Lay the grid at the rate of the first camera; whether it has changed."""
        is_camera = camera.kind not in WITHOUT_CAMERA
        if self.shared_goal is not None and (self.grid_is_of_cameras or not is_camera):
            return False
        self.grid_is_of_cameras = is_camera or self.period_ns is not None
        goal = Goal(now_ns, self.period_ns or camera.period_ns)
        if self.shared_goal is not None and goal.period_ns == self.shared_goal.goal.period_ns:
            return False
        self.shared_goal = SharedGoal(goal)
        return True

    def release_grid(self, cameras: Iterable[CameraFacts]) -> bool:
        """Let the next camera lay the grid where none of these can be held on it; whether that is so."""
        goal = self.goal
        if goal is None or self.period_ns is not None or not self.grid_is_of_cameras:
            return False
        near_ns = goal.period_ns * HOPELESS_PPM * 1e-6
        if any(abs(camera.period_ns - goal.period_ns) <= near_ns for camera in cameras):
            return False
        self.grid_is_of_cameras = False
        return True

    def message(self, pace_ns: int) -> Terms:
        """Return what is told; `pace_ns` is the mean time between two requests that the leader bears."""
        assert self.shared_goal is not None, "the first hello sets the goal"
        goal = self.shared_goal.goal
        return Terms(
            leader=self.leader,
            anchor_leader_ns=goal.anchor_leader_ns,
            period_ns=goal.period_ns,
            align_row=self.align_row,
            meeting_leader_ns=self.shared_goal.meeting_leader_ns,
            pace_ns=pace_ns,
            upstream=self.upstream,
            in_holdover=self.in_holdover,
        )

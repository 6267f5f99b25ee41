"""A leader's own terms, alike for all its clients: the grid of instants and the way to the root's time."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from capture_app.camera_facts import CameraFacts
from capture_app.sync.phase.aligner import HOPELESS_PPM
from capture_app.sync.phase.goal import Goal
from capture_app.sync.phase.shared_goal import SharedGoal
from capture_app.sync.rig.orders import Orders
from capture_app.sync.rig.roster import Roster
from capture_app.sync.wire.messages import WITHOUT_CAMERA, Terms
from capture_app.sync.wire.upstream_map import UpstreamMap

SLOWEST_VIDEO_NS = 1_000_000_000
"""A camera with longer frames lays the grid only where no other is here."""
FEW_CAMERAS, UPDATE_EVERY_NS = 20, 200_000
"""The goal of more than a few cameras is updated once in so long for each of them, not at each heartbeat."""


@dataclass(slots=True)
class RigTerms:
    """A leader's own terms, as they are at present."""

    leader: int
    """Its run."""
    period_ns: int | None
    """The rig's, where it was asked for; None where the cameras set it."""
    align_row: float | None
    grid_phase_ns: int | None = None
    """Leader time modulo the period at the grid's instants, where that is given: no camera moves it then."""
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
        period_ns = self.period_ns or camera.period_ns
        phase_ns = now_ns if self.grid_phase_ns is None else self.grid_phase_ns
        goal = Goal(now_ns - (now_ns - phase_ns) % period_ns, period_ns)
        if self.shared_goal is not None and goal.period_ns == self.shared_goal.goal.period_ns:
            return False
        self.shared_goal = SharedGoal(goal)
        return True

    def is_held(self, camera: CameraFacts) -> bool:
        """Whether a camera can be held on the present grid."""
        goal = self.goal
        return goal is not None and abs(camera.period_ns - goal.period_ns) <= _near_ns(goal.period_ns)

    def follow_cameras(self, cameras: Sequence[CameraFacts], now_ns: int) -> bool:
        """Lay the grid at the rate of most of these cameras; whether it has changed.

        Of equals the present one stays; rates of stills, not of video, are for rigs that have nothing else.
        Without any camera the next one lays it.
        """
        goal = self.goal
        if goal is None or self.period_ns is not None or not self.grid_is_of_cameras:
            return False
        if not cameras:
            self.grid_is_of_cameras = False
            return False
        ordered = sorted(camera.period_ns for camera in cameras)

        def support(period_ns: int) -> tuple[bool, int]:
            near_ns = _near_ns(period_ns)
            held = bisect_right(ordered, period_ns + near_ns) - bisect_left(ordered, period_ns - near_ns)
            return held > 0 and period_ns <= SLOWEST_VIDEO_NS, held

        best_ns = max(dict.fromkeys(camera.period_ns for camera in cameras), key=support)
        if support(best_ns) <= support(goal.period_ns):
            return False
        self.shared_goal = SharedGoal(Goal(now_ns, best_ns))
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


class GridReview:
    """When a leader's grid is laid anew, or moved, by who is here; not near a burst."""

    def __init__(self, terms: RigTerms, roster: Roster, orders: Orders) -> None:
        self._terms, self._roster, self._orders = terms, roster, orders
        self.is_due = False
        """Whether the cameras that the grid suits may not be those that are here."""
        self._goal_due_ns = 0

    def review(self, now_ns: int) -> bool:
        """Lay the grid as most cameras have it; whether it has changed.

        One that has said no more than hello has no vote where another one is here.
        """
        if self._orders.is_busy(now_ns):
            return False
        self.is_due = False
        voters = self._roster.cameras() or self._roster.cameras(even_unconfirmed=True)
        return self._terms.follow_cameras([member.camera for member in voters], now_ns)

    def update_goal(self, now_ns: int) -> bool:
        """Move the goal to suit the cameras that cannot follow it; whether it has changed."""
        shared, immovable = self._terms.shared_goal, len(self._roster.immovable)
        if shared is None or self._terms.upstream is not None or self._terms.grid_phase_ns is not None:
            return False
        if self._orders.is_busy(now_ns):
            return False
        if immovable > FEW_CAMERAS and now_ns < self._goal_due_ns:
            return False
        self._goal_due_ns = now_ns + immovable * UPDATE_EVERY_NS
        return shared.update(self._roster.camera_phases(), now_ns)


def _near_ns(period_ns: int) -> float:
    return period_ns * HOPELESS_PPM * 1e-6

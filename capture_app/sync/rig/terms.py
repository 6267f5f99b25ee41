"""What a leader tells all its clients alike: the grid of instants, and how its clock stands to the root's."""

from dataclasses import dataclass

from capture_app.camera_facts import CameraFacts
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.clock.upstream_map import UpstreamMap
from capture_app.sync.phase.goal import MAX_PERIOD_NS, MIN_PERIOD_NS, Goal
from capture_app.sync.phase.shared_goal import SharedGoal
from capture_app.sync.rig.roster import Member
from capture_app.sync.wire.beacon import Group
from capture_app.sync.wire.messages import WITHOUT_CAMERA, HeartbeatAck, Hello, Welcome


@dataclass(frozen=True, slots=True)
class LeaderTerms:
    """The same as a client has it: what its leader, or relay, has told last; times in ns."""

    leader: int
    path: tuple[int, ...]
    """Instances from the root to this leader."""
    goal: Goal
    align_row: float | None
    meeting_leader_ns: int | None
    pace_ns: int
    upstream: TimeMap | None
    """From the leader's clock to the root's; None where it is the root."""
    in_holdover: bool

    @classmethod
    def told_by(cls, message: Welcome | HeartbeatAck) -> "LeaderTerms | None":
        """Return what a message tells; None where it cannot be."""
        upstream = None if message.upstream is None else message.upstream.time_map()
        if message.upstream is not None and upstream is None:
            return None
        if not MIN_PERIOD_NS <= message.period_ns <= MAX_PERIOD_NS:
            return None
        answer = message if isinstance(message, HeartbeatAck) else None
        return cls(
            leader=message.leader,
            path=(message.leader,) if message.upstream is None else (*message.upstream.path, message.leader),
            goal=Goal(message.anchor_leader_ns, message.period_ns),
            align_row=message.align_row,
            meeting_leader_ns=None if answer is None else answer.meeting_leader_ns,
            pace_ns=message.pace_ns,
            upstream=upstream,
            in_holdover=answer is not None and answer.in_holdover,
        )

    def root_map(self, own: TimeMap) -> TimeMap:
        """Return the map to the root's clock from that to the leader's."""
        return own if self.upstream is None else own.chained_to(self.upstream)


@dataclass(slots=True)
class RigTerms:
    """What holds for all at present; `period_ns` is the rig's where it was asked for."""

    leader: int
    """Its run."""
    transfer_port: int
    period_ns: int | None
    align_row: float | None
    beacons: Group | None
    shared_goal: SharedGoal | None = None
    upstream: UpstreamMap | None = None
    """Of a relay: from its clock to the root's, for the clients to add to their estimates."""
    in_holdover: bool = False
    """Of a relay: nobody above it orders bursts at present."""
    grid_is_of_cameras: bool = False
    """Whether the grid's period is that of cameras, not one that holds until the first of them comes."""

    @property
    def goal(self) -> Goal | None:
        """The grid of instants that all cameras are moved onto; None before the first client."""
        return None if self.shared_goal is None else self.shared_goal.goal

    def lay_grid(self, camera: CameraFacts, now_ns: int) -> bool:
        """Lay a grid at the rate of the first camera; whether it is another one than before."""
        is_camera = camera.kind not in WITHOUT_CAMERA
        if self.shared_goal is not None and (self.grid_is_of_cameras or not is_camera):
            return False
        self.grid_is_of_cameras = is_camera or self.period_ns is not None
        goal = Goal(now_ns, self.period_ns or camera.period_ns)
        if self.shared_goal is not None and goal.period_ns == self.shared_goal.goal.period_ns:
            return False
        self.shared_goal = SharedGoal(goal)
        return True

    def welcome(self, hello: Hello, member: Member, pace_ns: int) -> Welcome:
        """Return what a client is told that is taken in."""
        assert self.shared_goal is not None, "the first hello sets the goal"
        goal = self.shared_goal.goal
        return Welcome(
            hello.instance,
            self.leader,
            member.number,
            self.transfer_port,
            goal.anchor_leader_ns,
            goal.period_ns,
            member.slot,
            self.align_row,
            pace_ns,
            self.upstream,
            self.beacons,
        )

    def acknowledgement(self, member: Member, pace_ns: int) -> HeartbeatAck:
        """Return what a client is told that is here."""
        assert self.shared_goal is not None, "the first hello sets the goal"
        goal = self.shared_goal.goal
        return HeartbeatAck(
            member.number,
            self.leader,
            goal.anchor_leader_ns,
            goal.period_ns,
            self.shared_goal.meeting_leader_ns,
            self.align_row,
            pace_ns,
            self.upstream,
            self.in_holdover,
        )

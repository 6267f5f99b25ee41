"""Where a client stands with its leader: the grid it was told, and what its frames' timestamps make of it."""

from dataclasses import dataclass

from capture_app.camera_facts import CameraFacts
from capture_app.sync.phase.goal import Goal
from capture_app.sync.wire.messages import HeartbeatAck, Welcome


@dataclass(slots=True)
class Membership:
    """What the leader told this client since it joined, and when it was last heard, local ns."""

    camera: CameraFacts
    """This client's."""
    leader: int
    client: int
    goal: Goal
    heard_ns: int
    align_row: float | None = None
    agreed_leader_ns: int | None = None
    asked: bool = False
    """Whether the leader was told the phase as it is now."""
    answered: bool = False
    """Whether it has answered since."""

    @classmethod
    def begin(cls, camera: CameraFacts, welcome: Welcome, now_ns: int) -> "Membership":
        """Join with a welcome that arrived at `now_ns`."""
        goal = Goal(welcome.anchor_leader_ns, welcome.period_ns)
        return cls(camera, welcome.leader, welcome.client, goal, now_ns, welcome.align_row)

    def take_answer(self, answer: HeartbeatAck) -> bool:
        """Note what the leader tells now; whether it is the first since it was told the phase as it is."""
        self.goal = Goal(answer.anchor_leader_ns, answer.period_ns)
        self.align_row, self.agreed_leader_ns = answer.align_row, answer.agreed_leader_ns
        first = self.asked and not self.answered
        self.answered = self.answered or first
        return first

    @property
    def offset_ns(self) -> int:
        """Time from a frame's timestamp to the moment of it that is aligned; 0 where nobody can tell."""
        return self._offset_ns or 0

    @property
    def _offset_ns(self) -> int | None:
        return 0 if self.align_row is None else self.camera.mid_exposure_offset_ns(self.align_row)

    @property
    def goal_of_stamps(self) -> Goal:
        """The grid that the frames' timestamps should lie on."""
        return Goal(self.goal.anchor_leader_ns - self.offset_ns, self.goal.period_ns)

    @property
    def why_no_centre(self) -> str:
        """Say that exposure centres were asked for and this camera's is not known; else empty."""
        if self._offset_ns is not None:
            return ""
        return "its rows or exposure are not known: it is aligned by its timestamps, not by a row's centre"

    @property
    def may_move(self) -> bool:
        """Whether the leader leaves it to this client to move: restarts wait for what suits all cameras."""
        return self.camera.phase_control != "reset" or (self.answered and self.agreed_leader_ns is not None)

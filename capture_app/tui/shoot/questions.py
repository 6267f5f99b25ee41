"""What is asked before a take: whether to wait for cameras that still sync, and whether to keep the last."""

from textual.content import Content
from textual.widgets import Static

from capture_app.node.wire.status import NodeStatus, RigStatus
from capture_app.sync.wire.messages import NodeState
from capture_app.text import count, duration, printable
from capture_app.tui.messages import StatusChanged
from capture_app.tui.question import CANCEL, Answer, Question
from capture_app.tui.shoot.take import JudgedTake
from capture_app.tui.states import cameras_of

ANYWAY = (Answer("wait", "w", "Wait, then take"), Answer("take", "t", "Take now"), CANCEL)
AGAIN = (Answer("keep", "k", "Keep, take again"), Answer("trash", "t", "Trash, take again"), CANCEL)

DRIFT_TOLERANCES = 2
"""So many tolerances off is still a camera in step whose drift is being corrected."""


class NotReadyQuestion(Question):
    """Says what keeps the cameras from being ready, as it is now."""

    def on_status_changed(self, message: StatusChanged) -> None:
        """Say it anew."""
        text = doubts_about(message.status) or "All cameras are ready now."
        self.query_one(".question", Static).update(Content(printable(text)))


def not_ready_question(status: RigStatus | None) -> Question | None:
    """Ask whether to `wait` until the rig is ready, or to `take` all the same; None where it is."""
    doubts = "" if status is None else doubts_about(status)
    return NotReadyQuestion(doubts, ANYWAY, title="Not ready") if doubts else None


def again_question(take: JudgedTake) -> Question:
    """Ask whether to `keep` the take before or to `trash` it."""
    verdict = take.verdict
    text = f"{take.sheet.session.name} is {verdict.headline}\nspread {verdict.spread}"
    return Question(text, AGAIN, title="Take again")


def doubts_about(status: RigStatus) -> str:
    """Say in sentences which cameras are not ready and what their pictures will be; empty: none."""
    cameras = cameras_of(status)
    unready = [node for node in cameras if node.state is not NodeState.READY and not _touches_up(node)]
    here = [node for node in unready if node.state is not NodeState.LOST]
    if not here:
        return ""
    ready = len(cameras) - len(unready)
    lines = [f"{ready} of {len(cameras)} cameras are ready."]
    lines += [_doubt(node, status.period_ns) for node in here[:6]]
    if len(here) > 6:
        lines.append(f"and {count(len(here) - 6, 'more camera')}")
    return "\n".join(lines)


def _touches_up(node: NodeStatus) -> bool:
    """Whether a camera in step is just correcting a drift: for a moment, which is no reason to ask."""
    error_ns = node.phase_error_ns
    aligning = node.state is NodeState.ALIGNING and error_ns is not None
    return aligning and abs(error_ns or 0) <= DRIFT_TOLERANCES * node.tolerance_ns


def _doubt(node: NodeStatus, period_ns: int | None) -> str:
    if node.state is NodeState.ALIGNING:
        most_ns = period_ns // 2 if period_ns else None
        error_ns = most_ns if node.phase_error_ns is None else abs(node.phase_error_ns)
        fate = (
            f"its pictures will be about {duration(error_ns)} off" if error_ns else "its pictures will be off"
        )
    elif node.state is NodeState.FAILED:
        fate = "it gives no pictures"
    else:
        fate = "its pictures will be missing or at an unsure time"
    reason = f" ({node.message})" if node.message else ""
    return f"{node.name} is {node.state}{reason}: {fate}."

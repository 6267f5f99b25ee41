"""What is asked before the screen closes: whether the rig goes on, and whether running jobs may end."""

from capture_app.node.wire.status import RigStatus
from capture_app.sync.wire.messages import NodeState
from capture_app.text import count
from capture_app.tui.question import Answer, Question

LEAVE, STOP, STAY = "leave", "stop", "stay"


def quit_question(status: RigStatus | None, *, started: bool, local: bool, jobs: int) -> Question | None:
    """What to ask; None where nothing would be lost and no rig of this machine's is left behind.

    `started`: the rig was started for this screen; `jobs`: how many run or wait.
    """
    own = [] if status is None else [n for n in status.nodes if n.on_leader and n.state is not NodeState.LOST]
    asks_for_rig = local and status is not None and bool(own or (started and status.nodes))
    lines: list[str] = []
    if asks_for_rig and status is not None:
        own_cameras = f" with {count(len(own), 'camera')}" if own else ""
        lines.append(
            f"The rig at {status.leader}{own_cameras} can go on without the screen; "
            "capture-app finds it when it is started again."
        )
        if status.burst is not None and not status.burst.done:
            lines.append(f"{status.burst.name} is being saved: stopped now, it keeps what has come.")
    if jobs:
        lines.append(f"{count(jobs, 'job')} would end unfinished.")
    if not lines:
        return None
    if asks_for_rig:
        answers = [
            Answer(LEAVE, "l", "Leave it running"),
            Answer(STOP, "s", "Stop the rig"),
            Answer(STAY, "n", "Stay here"),
        ]
    else:
        answers = [Answer(STAY, "n", "Stay here"), Answer(LEAVE, "y", "Quit")]
    return Question("\n\n".join(lines), answers, title="Quit?")

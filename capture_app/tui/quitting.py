"""What is asked before the screen closes: whether the rig goes on, and whether running jobs may end."""

from collections.abc import Sequence

from capture_app.node.wire.status import RigStatus
from capture_app.sync.wire.messages import NodeState
from capture_app.text import count
from capture_app.tui.question import Answer, Question

LEAVE, STOP, STAY = "leave", "stop", "stay"
NAMED_JOBS = 2
"""So many are named; of the others the number is told."""


def quit_question(
    status: RigStatus | None, *, started: bool, local: bool, jobs: Sequence[str]
) -> Question | None:
    """What to ask; None where nothing would be lost and no rig of this machine's is left behind.

    `started`: the rig was started for this screen; `jobs`: those that run or wait, and how far they are.
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
        ends = "ends" if len(jobs) == 1 else "end"
        named = ", ".join(jobs[:NAMED_JOBS])
        more = f" and {count(len(jobs) - NAMED_JOBS, 'more job')}" if len(jobs) > NAMED_JOBS else ""
        lines.append(f"{named}{more} {ends} with the screen, without a result.")
    if not lines:
        return None
    ending = f", end the {'job' if len(jobs) == 1 else 'jobs'}" if jobs else ""
    stay = Answer(STAY, "n", "Stay here")
    if not asks_for_rig:
        return Question("\n\n".join(lines), [stay, Answer(LEAVE, "y", "Quit" + ending)], title="Quit?")
    answers = [Answer(LEAVE, "l", f"Leave the rig running{ending}"), Answer(STOP, "s", "Stop the rig")]
    # The first has the focus: Enter ends no work.
    answers = [stay, *answers] if jobs else [*answers, stay]
    return Question("\n\n".join(lines), answers, title="Quit?")

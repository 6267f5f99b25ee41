"""Commands after an import: one table, from what a session has and lacks to what works for it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from capture_app.common.instants import COMPARED_MS
from capture_app.common.text import command_line
from capture_app.session.reading.reader import Session


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """What decides which commands work for a session."""

    cameras: int
    instants: int
    calibrated: bool
    aligned: bool
    """Whether its times are common and accurate enough to pair its images."""
    comparable: bool
    """Whether two of its frames are as far apart as a comparison needs."""

    @property
    def has_depth(self) -> bool:
        """Whether an instant of it gives depth."""
        return self.cameras > 1 and self.calibrated and self.aligned


STEPS: Sequence[tuple[str, str, Callable[[Situation], bool]]] = (
    (
        "calibrate from a board that they were shown, with --dictionary none from a plain chessboard",
        "reconstruct calibrate {folder} --from board --board COLUMNSxROWS --square-mm MM",
        lambda its: its.cameras > 1 and not its.calibrated,
    ),
    (
        "calibrate from a file or another session of these cameras",
        "reconstruct calibrate {folder} --from PATH",
        lambda its: its.cameras == 2 and not its.calibrated,
    ),
    (
        "calibrate by what is still and the cameras' horizontal view in degrees",
        "reconstruct calibrate {folder} --field-of-view DEG",
        # Images of two cameras do not determine their lenses.
        lambda its: its.cameras == 2 and not its.calibrated,
    ),
    (
        "calibrate from a file or another session, or without --from by what is still",
        "reconstruct calibrate {folder} --from PATH",
        lambda its: its.cameras > 2 and not its.calibrated,
    ),
    (
        "align by what moves, with a calibration",
        "reconstruct time {folder} --apply",
        lambda its: its.cameras > 1 and not its.aligned,
    ),
    (
        "compute the depth of an instant",
        "reconstruct multiview {folder} --out {name}-multiview",
        lambda its: its.has_depth and not its.comparable,
    ),
    (
        "look at the pictures",
        "capture-app sessions sheet {folder} --out {name}.jpg",
        lambda its: not its.has_depth or (its.instants > 1 and not its.comparable),
    ),
    (
        "see what synchronization changes",
        "reconstruct compare {folder} --out {name}-compare",
        lambda its: its.has_depth and its.comparable,
    ),
)
"""What a command is for, the command, and the situations in which it works.

`{folder}` and `{name}` are the session's, words in capitals are the user's. The last one that works is the
next one, and works whatever the pictures show.
"""


def describe_steps(session: Session) -> list[str]:
    """Return a line for each command that works for a session; the last one is the next command."""
    its, folder = situation_of(session), command_line(str(session.folder))
    steps = [(purpose, command) for purpose, command, works in STEPS if works(its)]
    return [
        ("next: " if number == len(steps) else f"to {purpose}: ")
        + command.format(folder=folder, name=session.folder.name)
        for number, (purpose, command) in enumerate(steps, 1)
    ]


def situation_of(session: Session) -> Situation:
    """Return what a session has and lacks."""
    cameras, burst = session.manifest.cameras, session.manifest.burst
    times_ns = burst.instants_ns
    step_ns = min((after - before for before, after in pairwise(times_ns)), default=0)
    # A comparison looks for this delay between two frames, to within half of their interval.
    compared_ns = COMPARED_MS * 1e6
    return Situation(
        cameras=len(cameras),
        instants=len(times_ns),
        calibrated=session.calibration() is not None,
        aligned=not are_times_uncertain(session),
        comparable=step_ns <= 2 * compared_ns and times_ns[-1] - times_ns[0] >= compared_ns - step_ns / 2,
    )


def are_times_uncertain(session: Session) -> bool:
    """Return whether a session has several instants, and common times too inaccurate to synchronize it."""
    burst = session.manifest.burst
    times = None if len(burst.instants_ns) < 2 else burst.common_times
    return times is not None and bool(times.why_not_synchronized(burst.period_ns))

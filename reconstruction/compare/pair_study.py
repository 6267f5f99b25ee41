"""What the two studies of a pair of cameras have in common: the pair, its instants and its own condition."""

from typing import Self

from reconstruction.calibration.pair_choice import PairChoice
from reconstruction.calibration.rig import Rig
from reconstruction.compare.study import SYNCHRONIZED
from reconstruction.session.conditions import Condition
from reconstruction.session.frame_offset import FrameOffset, evenly_spread
from reconstruction.session.shown_instants import pair_instants

Pair = tuple[str, str]


class PairStudy:
    """A study of two cameras whose second is late."""

    def __init__(self, rig: Rig, offset: FrameOffset | None, asked: Pair | None, max_instants: int) -> None:
        """`offset`: how late, None = not at all; `asked`: the cameras, None = chosen from the images."""
        self.rig = rig
        self.dataset = rig.dataset
        self.motion = rig.motion
        self.offset = offset
        self.asked = asked
        self.max_instants = max_instants
        self.cameras: Pair = ("", "")
        self.reason = ""

    @property
    def steps(self) -> int:
        """One for choosing the cameras, and one for each instant."""
        return 1 + min(len(self.offset.pairs) if self.offset else 0, self.max_instants)

    @property
    def condition(self) -> Condition:
        """The second camera is late by the offset that was asked for."""
        if self.offset is None:
            return SYNCHRONIZED
        return Condition(f"{self.offset.asked_ms:g}ms", named_ms=((self.cameras[1], self.offset.asked_ms),))

    def for_session(self, rig: Rig) -> Self:
        """The same pair of another session, synchronized."""
        theirs = type(self)(rig, None, self.cameras, self.max_instants)
        theirs.reason = self.reason
        return theirs

    def use_pair(self, choice: PairChoice) -> None:
        """Use the chosen pair.

        Raises:
            ValueError: no pair could be chosen.
        """
        if choice.cameras is None:
            raise ValueError(choice.why)
        self.cameras, self.reason = choice.cameras, self.reason or choice.why

    def instant_pairs(self, condition: Condition) -> tuple[list[tuple[int, int]], float | None]:
        """The instants that the two cameras show, spread over the burst, and how late the second is, ms.

        None for the latter where both are of one instant, or where every instant is drawn for itself.

        Raises:
            ValueError: the burst does not hold the condition.
        """
        first, second = self.cameras
        if condition == SYNCHRONIZED:
            found = [(k, k) for k in self.dataset.instants(first) if self.dataset.has_image(second, k)]
            if not found:
                raise ValueError(f"{self.dataset.name} has no images of {first} and {second} of one instant")
            return evenly_spread(found, self.max_instants), None
        found, late_ms = pair_instants(self.dataset, condition, first, second)
        return evenly_spread(found, self.max_instants), late_ms

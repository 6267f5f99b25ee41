"""The matchers that find depth from all cameras, by name."""

from enum import StrEnum


class Matcher(StrEnum):
    """The requested matcher."""

    AUTO = "auto"
    SWEEP = "sweep"
    GPU = "gpu"
    PATCHMATCH = "patchmatch"

    @property
    def engine(self) -> "Matcher":
        """The matcher that runs; AUTO is the sweep, which finds more, and GPU is the sweep on a GPU."""
        return Matcher.SWEEP if self in (Matcher.AUTO, Matcher.GPU) else self


MATCHER_HELP = (
    "Method for depth from all cameras. sweep runs on the CPU; gpu is sweep on a GPU, up to 1.7 times as"
    " fast; patchmatch is COLMAP's and needs an NVIDIA GPU. auto is sweep, which finds more."
)

"""The matchers that find depth from all cameras, by name."""

from enum import StrEnum


class Matcher(StrEnum):
    """The requested matcher."""

    AUTO = "auto"
    SWEEP = "sweep"
    PATCHMATCH = "patchmatch"

    @property
    def engine(self) -> "Matcher":
        """The matcher that runs; AUTO is the sweep, which finds more."""
        return Matcher.SWEEP if self is Matcher.AUTO else self


MATCHER_HELP = (
    "Method for depth from all cameras. sweep runs on the CPU; patchmatch is COLMAP's and needs an"
    " NVIDIA GPU. auto is sweep, which finds more."
)

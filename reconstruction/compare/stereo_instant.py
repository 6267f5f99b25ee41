"""One instant of a pair's depth, synchronized and offset."""

from dataclasses import dataclass

from reconstruction.common.geometry import Array
from reconstruction.stereo.stereo_pair import DepthMap, StereoPair


@dataclass(frozen=True)
class StereoInstant:
    """Depth by side (`synced`, `offset`), and the pixels it is measured on (bool, reference view).

    `truth` is in the calibration's unit, NaN = unknown; None where the truth is unknown.
    """

    now: int
    later: int
    maps: dict[str, DepthMap]
    moving: Array
    static: Array
    truth: Array | None
    matcher: StereoPair

    def shown(self, side: str) -> int:
        """The instant that the second camera shows."""
        return self.now if side == "synced" else self.later

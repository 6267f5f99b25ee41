"""The ground truth of a simulated session: `ground_truth/times.json` and one .npz an image."""

from msgspec import Struct

from capture_app.common.clock import SimulatedClock
from capture_app.session.format.manifest import GROUND_TRUTH, Sha256

TIMES = f"{GROUND_TRUTH}/times.json"
TRUE_TIMES_JOURNAL = f"{GROUND_TRUTH}/times.ndjson"
"""The true times, a line each as they come, of a burst that a crash may interrupt."""


class TrueTime(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """True start of the first row's exposure of one image, in ns of the host's clock."""

    camera: str
    instant: int
    true_ns: int
    sha256: Sha256 | None = None
    """Checksum of the image's .npz; None where it has none."""


class TrueTimes(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """True times of the images, and the true clock of each camera by name."""

    images: tuple[TrueTime, ...] = ()
    clocks: dict[str, SimulatedClock] = {}


def ground_truth_path(camera: str, instant: int) -> str:
    """Return the path of an image's ground truth, relative to its session."""
    return f"{GROUND_TRUTH}/{camera}/{instant:06d}.npz"

"""A take as a table: cameras across by name, instants down, a note on each image."""

from pathlib import Path
from typing import TYPE_CHECKING, Self

from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.common.text import duration
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.reading.decoding import decode_image
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import judge

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PARALLEL = 1e3
"""Condition number of the equations for the point they look at above which optical axes count as parallel."""


def arc_order(session: Session) -> tuple[str, ...]:
    """Return the camera names in the order of their arc around the subject; sorted by name without poses.

    Raises BadInputError if the session's calibration is malformed.
    """
    names = sorted((camera.name for camera in session.manifest.cameras), key=natural_order)
    calibration = session.calibration()
    if calibration is None or len(names) < 3 or not all(name in calibration.cameras for name in names):
        return tuple(names)
    import numpy as np  # heavy: imported only if there are poses

    poses = [calibration.cameras[name] for name in names]
    rotations = np.array([pose.rotation for pose in poses])
    centres = -np.einsum("nij,ni->nj", rotations, np.array([pose.translation for pose in poses]))
    angles = _angles(centres, rotations[:, 2])
    order = np.argsort(angles)
    # The arc starts after its widest gap.
    gaps = np.diff(np.r_[angles[order], angles[order[0]] + 2 * np.pi])
    order = np.roll(order, -int(gaps.argmax()) - 1)
    found = tuple(names[index] for index in order)
    # Of the two directions, choose the one that starts with the earlier name.
    return found if natural_order(found[0]) <= natural_order(found[-1]) else found[::-1]


def _angles(centres: "NDArray[np.float64]", directions: "NDArray[np.float64]") -> "NDArray[np.float64]":
    """Return the cameras' angles around the point that they look at, in the plane of their optical axes.

    The point is the one nearest to all optical axes; for parallel axes it is far in front of the cameras.
    """
    import numpy as np

    from capture_app.session.format.lens import nearest_point

    middle = centres.mean(axis=0)
    target = nearest_point(centres, directions, PARALLEL)
    if target is None:
        target = middle + 1000 * np.abs(centres - middle).max() * directions.mean(axis=0)
    from_target = centres - target
    _, _, axes = np.linalg.svd(np.r_[from_target, centres - middle], full_matrices=False)
    return np.asarray(np.arctan2(from_target @ axes[1], from_target @ axes[0]), np.float64)


class TakeSheet:
    """A session's images by camera and instant."""

    def __init__(self, session: Session) -> None:
        """Read the camera order of a session. Raises BadInputError if its calibration is malformed."""
        self.session, self.verdict = session, judge(session.manifest)
        self.cameras = tuple(sorted((one.name for one in session.manifest.cameras), key=natural_order))
        self.arc = arc_order(session)
        """Cameras in the order of their arc, for pictures in motion."""
        self._images = {(image.camera, image.instant): image for image in session.manifest.images}
        self._missing = {(one.camera, one.instant): one.reason for one in session.manifest.missing}

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Open a session's folder as a sheet. Raises BadInputError, IncompleteError."""
        return cls(Session.open(folder))

    @property
    def instants(self) -> int:
        """Number of instants."""
        return len(self.session.manifest.burst.instants_ns)

    @property
    def aspect(self) -> float:
        """Height divided by width of the tallest camera's images."""
        return max(one.facts.height / one.facts.width for one in self.session.manifest.cameras)

    def image(self, camera: str, instant: int) -> ImageRecord | None:
        """Return a camera's image of an instant, or None. Raises BadInputError if there is no such place."""
        if camera not in self.cameras or not 0 <= instant < self.instants:
            raise BadInputError(
                f"{self.session.folder} has no camera {camera!r} at instant {instant}",
                hint=f"it has {', '.join(self.cameras)} at 0 to {self.instants - 1}",
            )
        return self._images.get((camera, instant))

    def note(self, camera: str, instant: int) -> str:
        """Return a short note on an image, or the reason why it is missing; empty if nothing is wrong."""
        image = self.image(camera, instant)
        if image is None:
            return self._missing.get((camera, instant), "missing")
        if image.late:
            return f"{duration(image.residual_ns, signed=True)} off"
        return "neighbouring frame" if image.substitute else ""

    def since_start_ns(self, instant: int) -> int:
        """Return the time of an instant since the first one, ns."""
        instants_ns = self.session.manifest.burst.instants_ns
        return instants_ns[instant] - instants_ns[0]

    def spread_ns(self, instant: int) -> int | None:
        """Return the time from the first to the last image of an instant, ns; None for fewer than two."""
        images = (self.image(camera, instant) for camera in self.cameras)
        times = [image.leader_ns for image in images if image is not None]
        return max(times) - min(times) if len(times) > 1 else None

    def load(self, camera: str, instant: int, width: int = 0) -> "NDArray[np.uint8] | None":
        """Decode an image (height x width x BGR), at least `width` px wide if possible; 0 for full size.

        Returns None if it is missing or unreadable. Blocks on the disk.
        """
        image = self.image(camera, instant)
        if image is None:
            return None
        try:
            data = self.session.image_bytes(image)
        except OSError:
            return None
        return decode_image(data, colour=True, min_width=width)

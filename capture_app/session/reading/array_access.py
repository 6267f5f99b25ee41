"""Python interface to a session: frames as arrays, decoded on request."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from capture_app.common.errors import BadInputError, IncompleteError, reading
from capture_app.session.files.untrusted_files import RESTORE_IMAGE, read_input
from capture_app.session.format.lens import Lens, distortion_of, triangulate_rays
from capture_app.session.format.manifest import EVENTS, CameraRecord, ImageRecord
from capture_app.session.format.marks import Mark, marks_of
from capture_app.session.reading.decoding import decode_image
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import Verdict, judge

TimeName = Literal[
    "leader_ns",
    "local_ns",
    "residual_ns",
    "uncertainty_ns",
    "hard_bound_ns",
    "exposure_start_ns",
    "exposure_ns",
    "true_ns",
]
"""Times that `OpenSession.times` returns: fields of `ImageRecord`, and the simulated true time."""
Pixels = npt.NDArray[np.uint8]
Numbers = npt.NDArray[np.float64]
V = TypeVar("V")


class ByCamera(dict[str, V]):
    """Values by camera; a name that is not one raises BadInputError, which lists the cameras."""

    def __missing__(self, name: str) -> V:
        raise BadInputError(f"no camera {name!r}", hint=f"the cameras are {', '.join(self)}")


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One camera's frame at one instant; each request for its image decodes the file.

    If the frame is missing, every attribute except `camera`, `instant` and `missing` raises IncompleteError.
    """

    camera: str
    instant: int
    """Index of the instant in the burst, from 0."""
    missing: str
    """Reason why the frame is missing; empty if it exists."""
    _record: ImageRecord | None
    _session: "OpenSession"

    def __repr__(self) -> str:
        if self._record is None:
            return f"<Frame {self.camera}, instant {self.instant}: {self.missing}>"
        error = "" if self.uncertainty_ns is None else f" ± {self.uncertainty_ns / 1000:.0f} us"
        return f"<Frame {self.camera}, instant {self.instant}: {self.leader_ns / 1e6:.3f} ms{error}>"

    @property
    def record(self) -> ImageRecord:
        """The frame's record in the manifest."""
        if self._record is None:
            raise IncompleteError(
                f"{self.camera} has no frame of instant {self.instant}: {self.missing}",
                hint="skip frames whose `missing` is set",
            )
        return self._record

    @property
    def leader_ns(self) -> int:
        """Capture time, ns in the leader's clock."""
        return self.record.leader_ns

    @property
    def uncertainty_ns(self) -> int | None:
        """95 % uncertainty of the capture time, ns; None if unknown."""
        return self.record.uncertainty_ns

    @property
    def hard_bound_ns(self) -> int | None:
        """Guaranteed bound on the error of the capture time, ns; None if there is no bound."""
        return self.record.hard_bound_ns

    @property
    def exposure_ns(self) -> int | None:
        """Exposure time of each row, ns; None if the camera does not report it."""
        return self.record.exposure_ns

    @property
    def is_substitute(self) -> bool:
        """Whether the camera dropped the frame nearest to the instant and this one replaces it."""
        return self.record.substitute

    @property
    def true_ns(self) -> int | None:
        """True capture time of a simulated frame, ns; in the leader's clock if that is the host's clock."""
        return self._session.all_true_ns.get((self.camera, self.record.instant))

    def bgr(self) -> Pixels:
        """Decode the image: uint8 height x width x 3 in OpenCV's BGR order; grey cameras get equal channels.

        Raises BadInputError if the file cannot be read or is not an image.
        """
        with reading(self.record.path):
            picture = decode_image(self._session.image_bytes(self.record), colour=True)
        if picture is None:
            raise BadInputError(f"{self.record.path} is not a picture", hint=RESTORE_IMAGE)
        return picture

    def rgb(self) -> Pixels:
        """Decode the image: uint8 height x width x 3 in RGB order. Raises BadInputError as `bgr` does."""
        return np.ascontiguousarray(self.bgr()[..., ::-1])

    def truth(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Return true depth (m along the optical axis, 0 = none) and moving regions of a simulated frame.

        Raises IncompleteError if the frame is not simulated.
        """
        if (truth := self._session.read_ground_truth(self.camera, self.record.instant)) is None:
            raise IncompleteError(
                f"{self.camera} has no true depth of instant {self.instant}",
                hint="only simulated sessions have it",
            )
        return truth


@dataclass(frozen=True, repr=False)
class InstantFrames:
    """One instant of the burst: the frames of all cameras, including missing ones."""

    number: int
    leader_ns: int
    """Target time of all frames of this instant, ns in the leader's clock; without their planned delays."""
    frames: dict[str, Frame]
    """Each camera's frame, in the session's order of cameras."""

    def __repr__(self) -> str:
        there = f"{sum(not frame.missing for frame in self.frames.values())} of {len(self.frames)} frames"
        return f"<InstantFrames {self.number}: {self.leader_ns / 1e6:.3f} ms, {there}>"

    def bgr(self) -> Pixels:
        """Decode all images: uint8 cameras x height x width x 3 in OpenCV's BGR order.

        Raises IncompleteError if one is missing, BadInputError if their sizes differ.
        """
        pictures = [frame.bgr() for frame in self.frames.values()]
        if len({picture.shape for picture in pictures}) > 1:
            raise BadInputError(
                "the cameras' pictures are of several sizes", hint="ask each frame for its own"
            )
        return np.stack(pictures)

    def rgb(self) -> Pixels:
        """Decode all images: uint8 cameras x height x width x 3 in RGB order. Raises as `bgr` does."""
        return np.ascontiguousarray(self.bgr()[..., ::-1])


@dataclass(frozen=True)
class CameraMatrices:
    """Calibration of a camera as in OpenCV: x right, y down, z forward, first pixel centre at (0, 0)."""

    camera_matrix: Numbers
    """3 x 3, in px of the stored images."""
    distortion: Numbers
    """k1, k2, p1, p2, k3; of a fisheye k1, k2, k3, k4."""
    cam_from_rig: Numbers
    """4 x 4: transforms a point from the rig's frame to the camera's, in `unit`."""
    unit: str
    """m, or arbitrary."""
    is_fisheye: bool = False

    @property
    def lens(self) -> Lens:
        """The lens, which maps pixels to rays and back."""
        return Lens(self.camera_matrix, self.distortion, self.is_fisheye)

    def project(self, points: npt.ArrayLike) -> Numbers:
        """Return the pixels (... x 2) of points (... x 3) in the rig's frame.

        They are NaN behind the camera: sum them up by `np.nanmedian` and its like.
        """
        points = np.asarray(points, np.float64)
        seen = points @ self.cam_from_rig[:3, :3].T + self.cam_from_rig[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = self.lens.project((seen[..., :2] / seen[..., 2:]).reshape(-1, 2))
        return np.where(seen[..., 2:] > 0, pixels.reshape(*points.shape[:-1], 2), np.nan)

    def undistort(self, image: Pixels) -> Pixels:
        """Return the image without lens distortion, with the same camera matrix and size."""
        return self.lens.undistort(image)

    def undistort_points(self, pixels: npt.ArrayLike) -> Numbers:
        """Return pixels (n x 2) as x / z and y / z (n x 2) in the camera's frame."""
        return self.lens.rays(pixels)


@dataclass(frozen=True, repr=False)
class CameraFrames:
    """One camera of a session: its frames of all instants, including missing ones."""

    name: str
    record: CameraRecord
    """The camera's properties, and the state of its clock and phase."""
    frames: tuple[Frame, ...]
    """One frame for each instant, in order."""
    _matrices: CameraMatrices | None

    def __repr__(self) -> str:
        there = f"{sum(not frame.missing for frame in self.frames)} of {len(self.frames)} frames"
        return f"<CameraFrames {self.name}: {there}, {'' if self.is_calibrated else 'not '}calibrated>"

    @property
    def is_calibrated(self) -> bool:
        """Whether the session has this camera's calibration."""
        return self._matrices is not None

    @property
    def calibration(self) -> CameraMatrices:
        """The camera's calibration. Raises IncompleteError if the session has none of it."""
        if self._matrices is None:
            raise IncompleteError(
                f"{self.name} is not calibrated",
                hint="run `reconstruct calibrate SESSION --from sfm`, or --from board",
            )
        return self._matrices


class Instants(tuple["InstantFrames", ...]):
    """All instants of a burst; IndexError for a number beyond them names their range."""

    __slots__ = ()

    def __getitem__(self, key: Any) -> Any:
        """Return an instant, or a slice of them."""
        try:
            return super().__getitem__(key)
        except IndexError:
            raise IndexError(f"no instant {key}: the instants are 0 to {len(self) - 1}") from None


class OpenSession(Session):
    """A session with its frames by instant and by camera; created by `open_session`."""

    @cached_property
    def instants(self) -> tuple[InstantFrames, ...]:
        """All instants, in order."""
        records = {(image.camera, image.instant): image for image in self.manifest.images}
        reasons = {(absence.camera, absence.instant): absence.reason for absence in self.manifest.missing}
        reasons |= dict.fromkeys(records, "")
        frames = {
            place: Frame(*place, reasons.get(place, "nothing says why"), records.get(place), self)
            for place in product(self._cameras, range(len(self.manifest.burst.instants_ns)))
        }
        return Instants(
            InstantFrames(k, leader_ns, ByCamera({camera: frames[camera, k] for camera in self._cameras}))
            for k, leader_ns in enumerate(self.manifest.burst.instants_ns)
        )

    @cached_property
    def sequence(self) -> tuple[Frame, ...]:
        """All frames in the order of their capture times, without missing ones and substitutes.

        In a staggered session these are the frames of one faster camera, from several places.
        """
        frames = (frame for instant in self.instants for frame in instant.frames.values())
        taken = [frame for frame in frames if not frame.missing and not frame.is_substitute]
        return tuple(sorted(taken, key=lambda frame: (frame.leader_ns, frame.camera)))

    @property
    def is_staggered(self) -> bool:
        """Whether the cameras took their frames one after the other, as planned, and not at one instant.

        The planned delay of each is `cameras[name].record.delay_ns`.
        """
        return self.manifest.is_staggered

    @cached_property
    def cameras(self) -> dict[str, CameraFrames]:
        """All cameras by name, in the session's order. Raises BadInputError for a malformed calibration."""
        return ByCamera(
            (
                name,
                CameraFrames(
                    name,
                    record,
                    tuple(instant.frames[name] for instant in self.instants),
                    self._matrices(record),
                ),
            )
            for name, record in self._cameras.items()
        )

    def frame(self, camera: str, instant: int) -> Frame:
        """Return a camera's frame at an instant (from 0). Raises BadInputError if there is no such frame."""
        frames = self._named(camera).frames
        if not 0 <= instant < len(frames):
            raise BadInputError(f"no instant {instant}", hint=f"the instants are 0 to {len(frames) - 1}")
        return frames[instant]

    def __repr__(self) -> str:
        kind = f"{len(self.cameras)} cameras, {len(self.instants)} instants"
        return f"<{type(self).__name__} {self.folder.name}: {kind}, {self.verdict.grade}>"

    @property
    def verdict(self) -> Verdict:
        """Synchronization quality of the burst, as text and numbers."""
        return judge(self.manifest)

    @cached_property
    def marks(self) -> tuple[Mark, ...]:
        """Events that operators noted during the take, in order. Raises BadInputError."""
        file = self.folder / EVENTS
        data = read_input(file) if file.exists() else b""
        return tuple(sorted(marks_of(data.splitlines()), key=lambda mark: mark.leader_ns))

    def times(self, name: TimeName = "leader_ns") -> "np.ma.MaskedArray[tuple[int, int], np.dtype[np.int64]]":
        """Return one time of every frame: int64 ns, cameras x instants; masked where missing or unknown.

        Raises BadInputError for a name that is none of `TimeName`.
        """
        if name not in (names := get_args(TimeName)):
            raise BadInputError(f"frames have no time {name!r}", hint=f"one of {', '.join(names)}")
        times_ns = [
            [
                None if frame.missing else getattr(frame if name == "true_ns" else frame.record, name)
                for frame in camera.frames
            ]
            for camera in self.cameras.values()
        ]
        return np.ma.MaskedArray(
            [[time or 0 for time in row] for row in times_ns],
            [[time is None for time in row] for row in times_ns],
            np.int64,
        )

    def triangulate(self, pixels: Mapping[str, npt.ArrayLike]) -> Numbers:
        """Return points (n x 3) in the rig's frame from their pixels (n x 2) in two or more cameras by name.

        Each point minimizes the algebraic error over all cameras (DLT: Hartley and Zisserman, 12.2). Raises
        IncompleteError if a camera is not calibrated, BadInputError if there are fewer than two cameras.
        """
        if len(pixels) < 2:
            raise BadInputError(f"one camera sees a ray, not a point: {', '.join(pixels)}", hint="name two")
        lenses = [(self._named(name).calibration, seen) for name, seen in pixels.items()]
        homogeneous = triangulate_rays(
            (lens.undistort_points(seen), lens.cam_from_rig[:3]) for lens, seen in lenses
        )
        return np.asarray(homogeneous[:, :3] / homogeneous[:, 3:])

    @cached_property
    def all_true_ns(self) -> dict[tuple[str, int], int]:
        """True times of a simulated session's frames, ns, by camera and instant; empty for other sessions."""
        truth = self.true_times()
        return {(image.camera, image.instant): image.true_ns for image in (truth.images if truth else ())}

    def _named(self, camera: str) -> CameraFrames:
        return self.cameras[self.camera(camera).name]

    def _matrices(self, camera: CameraRecord) -> CameraMatrices | None:
        if (rig := self.calibration()) is None or camera.name not in rig.cameras:
            return None
        truth = rig.cameras[camera.name]
        return CameraMatrices(
            camera_matrix=truth.matrix(camera.facts.width, camera.facts.height),
            distortion=distortion_of(truth),
            cam_from_rig=np.vstack(
                [np.column_stack([truth.rotation, truth.translation]), [0.0, 0.0, 0.0, 1.0]]
            ),
            unit=rig.unit,
            is_fisheye=truth.is_fisheye,
        )


def open_session(path: str | PathLike[str]) -> OpenSession:
    """Open a session's folder; images are read on request.

    Raises BadInputError if it is not a session, IncompleteError if its capture never finished.
    """
    return OpenSession.open(Path(path))

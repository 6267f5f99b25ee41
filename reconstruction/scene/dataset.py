"""Images and ground truth of a session, by camera and instant, optionally with corrected times."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from itertools import pairwise
from pathlib import Path
from typing import Self

import cv2
import msgspec
import numpy as np

from capture_app.common.camera_facts import unshared_uncertainties_ns
from capture_app.common.errors import BadInputError, IncompleteError, NotApplicableError, reading
from capture_app.common.instants import is_same_instant
from capture_app.console.terminal import talk
from capture_app.session.exporting.pinhole import straight_lens
from capture_app.session.files.untrusted_files import RESTORE_IMAGE
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.calibration_judge import camera_fault
from capture_app.session.format.camera_labels import require_camera
from capture_app.session.format.lens import lens_of
from capture_app.session.format.manifest import FrameRecord, ImageRecord
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import image_size, read_image, refuse_odd_shape
from reconstruction.common.memory import ByteCache, memory_budget
from reconstruction.common.picture_checksums import picture_checks


def shift_times(
    records: Iterable[ImageRecord],
    shifts_ms: Mapping[str, float],
    instants_ns: Sequence[int],
    period_ns: int,
) -> dict[tuple[str, int], ImageRecord]:
    """Add each camera's shift to its times, and return the images by camera and nearest instant.

    An image farther than half a period from every instant is left out, as is one whose instant has a nearer
    image of its camera. Records keep the instant under which they were saved.

    Raises:
        BadInputError: a shift leaves a camera without any image.
    """
    placed: dict[tuple[str, int], ImageRecord] = {}
    for record in records:
        if not (shift_ns := round(shifts_ms.get(record.camera, 0.0) * 1e6)):
            placed[record.camera, record.instant] = record
            continue
        leader_ns = record.leader_ns + shift_ns
        instant = min(range(len(instants_ns)), key=lambda k: abs(instants_ns[k] - leader_ns))
        residual_ns, other = leader_ns - instants_ns[instant], placed.get((record.camera, instant))
        if is_same_instant(residual_ns, period_ns) and (
            other is None or abs(residual_ns) < abs(other.residual_ns)
        ):
            start = record.exposure_start_ns
            placed[record.camera, instant] = msgspec.structs.replace(
                record,
                leader_ns=leader_ns,
                residual_ns=residual_ns,
                exposure_start_ns=None if start is None else start + shift_ns,
            )
    for camera, shift_ms in shifts_ms.items():
        if shift_ms and not any(name == camera for name, _ in placed):
            raise BadInputError(
                f"--time-shift-ms {camera}={shift_ms:g} leaves no image of {camera} at any instant",
                hint=f"the burst is {(instants_ns[-1] - instants_ns[0]) / 1e6:.0f} ms long",
            )
    return placed


class Dataset:
    """The images of one burst, read on demand, at a size that fits the memory budget.

    Reducing a dataset reduces everything: images, sizes, calibrated views, ground truth.
    """

    def __init__(self, session: Session, shifts_ms: Mapping[str, float] | None = None) -> None:
        """`shifts_ms` is added to the times of the named cameras; their images are then assigned again.

        Frames that a camera dropped are left out: their substitute images are of another instant.
        """
        manifest = session.manifest
        self.session = session
        self.name = manifest.name
        self.cameras = tuple(camera.name for camera in manifest.cameras)
        self.labels = manifest.labels
        """What their owner calls the cameras, by name."""
        self.instants_ns = manifest.burst.instants_ns
        self.period_ns = manifest.burst.period_ns
        self.time_shifts_ms = {
            require_camera(name, self.labels, "--time-shift-ms"): shift_ms
            for name, shift_ms in (shifts_ms or {}).items()
        }
        own_records = [record for record in manifest.images if not record.substitute]
        self._records = shift_times(own_records, self.time_shifts_ms, self.instants_ns, self.period_ns)
        self._scale = 1.0
        self._fisheyes: dict[str, tuple[CameraCalibration, CameraCalibration]] = {}
        self._read = self._image_cache()

    def straightened(self, calibration: Calibration) -> Self:
        """Return the dataset with fisheyes' images, and their ground truth, redrawn for a perspective lens.

        Its pose is the fisheye's, its size too; see `straight_lens`. What is not used of the images is said.
        """
        fisheyes = {
            name: (lens, straight_lens(lens))
            for name, lens in calibration.cameras.items()
            if lens.is_fisheye and name in self.cameras and not camera_fault(lens)
        }
        if not fisheyes:
            return self
        straight = copy(self)
        straight._fisheyes, straight._read = fisheyes, straight._image_cache()
        for name, lenses in fisheyes.items():
            whole, used = (lens_of(lens).field_deg(lens.width) for lens in lenses)
            talk(f"{name} is a fisheye: {used:.0f} of its {whole:.0f} degrees across are used")
        return straight

    def straight_calibration(self, calibration: Calibration) -> Calibration:
        """Return a calibration for the images as `straightened` has them."""
        straight = {name: lens for name, (_, lens) in self._fisheyes.items() if name in calibration.cameras}
        return msgspec.structs.replace(calibration, cameras={**calibration.cameras, **straight})

    @classmethod
    def open(cls, path: Path, shifts_ms: Mapping[str, float] | None = None) -> Self:
        """Open a session's folder; `shifts_ms` is as in the constructor.

        Raises:
            BadInputError: it is not a session, its manifest is broken, or it lacks a shifted camera.
            IncompleteError: an image is missing or truncated.
        """
        dataset = cls(Session.open(path), shifts_ms)
        for record in dataset._records.values():
            dataset._check(record)
        if not dataset.cameras or not dataset.instants_ns:
            raise BadInputError(
                f"{path} has no {'instants' if dataset.cameras else 'cameras'}",
                hint="use another session: capture-app sessions list shows them",
            )
        if any(after <= before for before, after in pairwise(dataset.instants_ns)):
            raise BadInputError(
                f"{path} has instants that do not follow each other in time",
                hint="restore its session.json from a copy, or import the recording again",
            )
        for camera in dataset.cameras:
            refuse_odd_shape(f"a picture of camera {camera}", *dataset.size(camera))
        return dataset.fitted(images=1)

    def fitted(
        self,
        *,
        images: int,
        bytes_per_pixel: float = 60,
        fixed_bytes: float = 0.0,
        fraction: float = 0.3,
    ) -> Self:
        """Return the dataset at a size at which work on `images` images fits `fraction` of the memory budget.

        `fixed_bytes` is memory independent of the size. A dataset that fits is returned as it is.

        Raises:
            BadInputError: it takes more even at a sixteenth of the size.
        """
        sizes = sorted((self.size(camera) for camera in self.cameras), key=lambda size: -size[0] * size[1])
        pixels = sum(width * height for width, height in sizes[:images])
        what = f"{images} pictures" if images > 1 else "a picture"
        scale = memory_budget().fit_scale(
            f"work on {what} of {self.name} ({'x'.join(map(str, sizes[0]))} pixels)",
            lambda scale: pixels * scale**2 * bytes_per_pixel + fixed_bytes,
            fraction=fraction,
        )
        if scale == 1.0:
            return self
        smaller = copy(self)
        smaller._scale *= scale
        smaller._read = smaller._image_cache()
        return smaller

    @property
    def other_labels(self) -> dict[str, str]:
        """What people call cameras, by name; only of cameras with another name."""
        return {name: label for name, label in self.labels.items() if name != label}

    def require_cameras(self, count: int, hint: str) -> None:
        """Raise NotApplicableError if the session has fewer cameras."""
        if len(self.cameras) < count:
            raise NotApplicableError(
                f"the session has one camera only ({', '.join(self.labels.values())})", hint=hint
            )

    def require_offset_each(self, offsets_ms: Sequence[float]) -> None:
        """Raise BadInputError unless there is one offset for each camera."""
        if len(offsets_ms) != len(self.cameras):
            raise BadInputError(
                f"{len(offsets_ms)} offsets for {len(self.cameras)} cameras",
                hint=f"give one for each, in this order: {', '.join(self.labels.values())}",
            )

    def has_image(self, camera: str, instant: int) -> bool:
        """Return whether there is an image of this camera at this instant."""
        return (camera, instant) in self._records

    def has_images(self, images: Iterable[tuple[str, int]]) -> bool:
        """Return whether all of these images exist, each given as a camera and an instant."""
        return all(image in self._records for image in images)

    def record(self, camera: str, instant: int) -> ImageRecord:
        """Return the record of an existing image."""
        return self._records[camera, instant]

    def instants(self, *cameras: str) -> tuple[int, ...]:
        """Return the instants at which all of these cameras have images."""
        return tuple(
            k for k in range(len(self.instants_ns)) if all(self.has_image(camera, k) for camera in cameras)
        )

    def image(self, camera: str, instant: int) -> Array:
        """Return an image, uint8 height x width x 3, BGR (grey cameras: three equal channels).

        Raises:
            BadInputError: the file is not an image, or not of its camera's size.
            IncompleteError: its checksum differs, and checksums are required.
        """
        return self._read(camera, instant)

    def _straighten(self, camera: str, image: Array, how: int) -> Array:
        """Return an image of a fisheye as its perspective lens sees it, and any other camera's unchanged."""
        if camera not in self._fisheyes:
            return image
        width, height = self.size(camera)
        fisheye, straight = (View.from_calibration(lens, width, height) for lens in self._fisheyes[camera])
        return np.asarray(cv2.remap(image, *fisheye.lens.maps((width, height), straight.matrix), how))

    def image_bytes(self, camera: str, instant: int) -> bytes:
        """Return the bytes of an image's file, of a fisheye a PNG of what is redrawn.

        Raises OSError if it cannot be read.
        """
        if camera in self._fisheyes:
            return cv2.imencode(".png", self.image(camera, instant))[1].tobytes()
        return self.session.image_bytes(self._records[camera, instant])

    def checked_bytes(self, camera: str, instant: int) -> bytes:
        """Return the bytes of an image's file, compared with its checksum; see `image` for errors."""
        record = self._records[camera, instant]
        path = self.session.image_file(record)
        with reading(path):
            data = self.session.image_bytes(record)
        picture_checks().check(path, data, record.sha256)
        return data

    def grey(self, camera: str, instant: int) -> Array:
        """Return an image's brightness, uint8 height x width."""
        return np.asarray(cv2.cvtColor(self.image(camera, instant), cv2.COLOR_BGR2GRAY))

    def size(self, camera: str) -> tuple[int, int]:
        """Return the width and height of a camera's images, px."""
        width, height = self.size_on_disk(camera)
        return max(1, round(width * self._scale)), max(1, round(height * self._scale))

    def size_on_disk(self, camera: str) -> tuple[int, int]:
        """Return the width and height of a camera's images before any reduction, px."""
        facts = self.session.camera(camera).facts
        return facts.width, facts.height

    def ground_truth(self, camera: str, instant: int) -> tuple[Array, Array] | None:
        """Return true depth (m, float32, 0 = unknown) and moving pixels (bool) of a simulated image, or None.

        Raises:
            BadInputError: the file is broken.
        """
        record = self._records.get((camera, instant))
        truth = self.session.read_ground_truth(camera, record.instant) if record is not None else None
        if truth is None or (self._scale == 1.0 and camera not in self._fisheyes):
            return truth
        size, how = self.size(camera), cv2.INTER_NEAREST_EXACT
        try:
            depth, moving = (cv2.resize(a, size, interpolation=how) for a in (truth[0], np.uint8(truth[1])))
        except cv2.error as error:
            raise BadInputError(
                f"{self.ground_truth_file(camera, instant)} is not a ground-truth file: {error}",
                hint="restore it from a copy, or delete it: only scores need it",
            ) from error
        depth, moving = (self._straighten(camera, np.asarray(a), cv2.INTER_NEAREST) for a in (depth, moving))
        return depth, moving > 0

    def ground_truth_file(self, camera: str, instant: int) -> Path | None:
        """Return the path of an image's ground truth, under its saved instant; None if there is none."""
        record = self._records.get((camera, instant))
        return self.session.ground_truth(camera, record.instant) if record is not None else None

    def fingerprint(self, calibration: Calibration | None) -> str:
        """Return one checksum over all images and a calibration; equal for equal sessions."""
        digest = hashlib.sha256()
        for (camera, instant), record in sorted(self._records.items()):
            digest.update(f"{camera} {instant} {record.sha256}\n".encode())
        digest.update(repr(calibration).encode())
        if self._scale < 1.0:
            digest.update(repr([self.size(camera) for camera in self.cameras]).encode())
        return digest.hexdigest()

    @property
    def unsynchronized(self) -> str:
        """Description of times too uncertain to assign images to instants; empty if the times are good."""
        times = self.session.manifest.burst.common_times
        shifted = any(self.time_shifts_ms.values())
        return "" if times is None or shifted else times.why_not_synchronized(self.period_ns)

    @property
    def staggered(self) -> str:
        """Description of the planned steps of a session whose cameras were staggered; empty for any other."""
        steps = self.session.manifest.steps
        return f"staggered on purpose, {steps}" if steps else ""

    @property
    def steps_ns(self) -> dict[str, int]:
        """Planned delay of each camera, ns; the images of an instant with one delay show one moment.

        All are 0 if no two cameras share a delay, as then no moment has depth.
        """
        delays_ns = {name: self.session.camera(name).delay_ns for name in self.cameras}
        shared = len({*delays_ns.values()}) < len(delays_ns)
        return delays_ns if shared else dict.fromkeys(delays_ns, 0)

    def planned_delay_ms(self, first: str, second: str) -> float:
        """Return the planned delay of the second camera's images beyond the first's, ms."""
        return (self.session.camera(second).delay_ns - self.session.camera(first).delay_ns) / 1e6

    @property
    def imported_error(self) -> tuple[float, str] | None:
        """The 95 % error of an imported session's times, us, with its source; None if it is unknown."""
        errors_ns = [record.uncertainty_ns for record in self._records.values()]
        times, known = self.session.manifest.burst.common_times, [ns for ns in errors_ns if ns is not None]
        if times is None or times.unknown or not known or len(known) < len(errors_ns):
            return None
        return max(known) / 1000, f"by {times.methods}" if times.methods else f"times {times.state}"

    def worst_residual_us(self) -> float | None:
        """Return the largest distance of an image from its planned time by the session's record, us.

        Includes the uncertainty of its camera's timestamps. None if the error of the times is unknown, as in
        imported sessions.
        """
        records = self._records.values()
        sure = all(record.uncertainty_ns is not None for record in records)
        if not records or not sure or self.session.manifest.origin == "imported":
            return None
        facts = {camera.name: camera.facts for camera in self.session.manifest.cameras}
        unknown_ns = unshared_uncertainties_ns(facts)
        for name, camera_facts in facts.items():
            unknown_ns[name] += 0 if camera_facts.stamp is None else camera_facts.stamp.uncertainty_ns
        return max(abs(record.residual_ns) + unknown_ns[record.camera] for record in records) / 1000

    def worst_hard_bound_us(self) -> float | None:
        """Return the largest hard bound on the error of an image's time, us; None if any image has none."""
        known = [r.hard_bound_ns for r in self._records.values() if r.hard_bound_ns is not None]
        return max(known) / 1000 if known and len(known) == len(self._records) else None

    def chosen_instants(self, asked: Sequence[int] | None) -> list[int]:
        """Return the instants asked for, in order and once each; None or none = all.

        Raises BadInputError if there is no such instant.
        """
        count = len(self.instants_ns)
        chosen = sorted({*(asked or range(count))})
        for instant in chosen:
            if not 0 <= instant < count:
                raise BadInputError(f"the session has no instant {instant}", hint=f"it has 0 to {count - 1}")
        return chosen

    def nearest_instants(self, instant: int, offsets_ms: Sequence[float]) -> dict[str, int]:
        """Return each camera's instant: the requested one, or the one nearest to its offset from it.

        Raises:
            BadInputError: there is no such instant, or a wrong number of offsets.
        """
        self.chosen_instants([instant])
        times = self.instants_ns
        if not offsets_ms:
            return dict.fromkeys(self.cameras, instant)
        self.require_offset_each(offsets_ms)
        chosen = {}
        for camera, offset_ms in zip(self.cameras, offsets_ms, strict=True):
            target_ns = times[instant] + round(offset_ms * 1e6)
            nearest = min(range(len(times)), key=lambda k: abs(times[k] - target_ns))
            if not is_same_instant(times[nearest] - target_ns, self.period_ns):
                span = (
                    f"its instants reach from {(times[0] - times[instant]) / 1e6:.0f} "
                    f"to {(times[-1] - times[instant]) / 1e6:.0f} ms from there"
                )
                having = [
                    number
                    for number, at_ns in enumerate(times)
                    if any(
                        is_same_instant(other_ns - at_ns - round(offset_ms * 1e6), self.period_ns)
                        for other_ns in times
                    )
                ]
                raise BadInputError(
                    f"no instant is {offset_ms:g} ms from instant {instant} of this burst",
                    hint=f"{span}; instant {having[0]} has one" if having else span,
                )
            chosen[camera] = nearest
        return chosen

    def _check(self, record: ImageRecord) -> None:
        if not (path := self.session.image_file(record)).is_file():
            raise IncompleteError(f"{path} is missing", hint=RESTORE_IMAGE)
        if isinstance(record, FrameRecord):
            if path.stat().st_size < record.offset + record.bytes:
                raise IncompleteError(
                    f"{path} ends before the frame of instant {record.instant}",
                    hint=RESTORE_IMAGE,
                )
        elif path.stat().st_size != record.bytes:
            raise IncompleteError(
                f"{path} has {path.stat().st_size} bytes, not {record.bytes}",
                hint=RESTORE_IMAGE,
            )

    def _image_cache(self) -> ByteCache:
        """Return a cache of images by camera and instant, all at the current scale."""
        # About an eighth of what there is.
        return ByteCache(self._read_image, int(0.12 * memory_budget().limit_bytes))

    def _read_image(self, camera: str, instant: int) -> Array:
        path = self.session.image_file(self._records[camera, instant])
        data = self.checked_bytes(camera, instant)
        size, on_disk = self.size_on_disk(camera), image_size(path, data)
        if sorted(on_disk) == sorted(size):
            image = read_image(path, self.size(camera) if self._scale < 1.0 else None, data)
            size, on_disk = self.size(camera), (image.shape[1], image.shape[0])
        if on_disk != size:
            raise BadInputError(
                f"{path} is {on_disk[0]}x{on_disk[1]}, but {camera} is {size[0]}x{size[1]}",
                hint="restore the image from a copy, or import the recording again",
            )
        # A bilinear image is blurred once more when views are drawn from it, by 0.3 dB.
        return self._straighten(camera, image, cv2.INTER_CUBIC)

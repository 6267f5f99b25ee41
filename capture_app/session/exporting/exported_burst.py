"""A burst being exported: its checked images in order, written as files, and their masks."""

import hashlib
from collections.abc import Callable
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.common.text import Progress
from capture_app.session.files.durable import link_or_copy
from capture_app.session.files.untrusted_files import RESTORE, RESTORE_IMAGE, read_regular
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.camera_labels import describe_pairs, pair_labels
from capture_app.session.format.lens import Picture, Redraw
from capture_app.session.format.manifest import MANIFEST, FrameRecord, ImageRecord
from capture_app.session.reading.decoding import decode_image, encode_image, size_of
from capture_app.session.reading.reader import Session

_SAME = {".jpeg": ".jpg", ".mjpeg": ".jpg", ".tif": ".tiff"}


class ExportedBurst:
    """The images of a session, by camera and instant. Cameras without images are left out.

    Raises BadInputError if the manifest contradicts itself: duplicate images, or times that decrease.
    """

    calibration: Calibration | None = None
    """Calibration of all cameras, if the exporter reads it."""

    def __init__(
        self,
        session: Session,
        progress: Progress,
        instant: int | None = None,
        *,
        link: bool = False,
        lossless: bool = False,
    ) -> None:
        """Take a session's images, or one `instant` only. Raises BadInputError if that has no image."""
        manifest = session.manifest
        self.session, self.link, self.lossless = session, link, lossless
        self.name = session.name
        self.instants_ns = manifest.burst.instants_ns
        self.period_ns = manifest.burst.period_ns
        self.recorded = self.images = _images_by_place(session)
        """The session's images (`recorded`), and the ones to export (`images`)."""
        self.frames: dict[tuple[str, int], tuple[str, int, ImageRecord | None]] = {}
        """Of each exported camera and instant: the file, the index of the frame in it from 0, and its image.

        The image is None for a blank frame.
        """
        self.drawn: dict[str, CameraCalibration] = {}
        """Cameras whose images are redrawn for another lens, with that lens."""
        self.on_warning: Callable[[str], None] = lambda note: None
        if instant is not None:
            self.images = {place: image for place, image in self.images.items() if place[1] == instant}
            if not self.images:
                raise BadInputError(
                    f"{session.folder} has no image of instant {instant}",
                    hint=f"there are 0 to {len(self.instants_ns) - 1}",
                )
        filmed = {camera for camera, _ in self.images}
        self.cameras = tuple(camera.name for camera in manifest.cameras if camera.name in filmed)
        if not self.cameras:
            raise BadInputError(
                f"{session.folder} has no images to export",
                hint="if it was interrupted: capture-app sessions repair SESSION",
            )
        self.notes: list[str] = [
            f"{camera.name} has no images" for camera in manifest.cameras if camera.name not in filmed
        ]
        _check_times(self)
        self.origin_ns = min(image.leader_ns for image in self.images.values())
        """Leader time of the earliest image, which is zero in exports with relative times."""
        self._progress, self._done = progress, 0
        self._mask_folders: dict[str, str] = {}

    @property
    def required_calibration(self) -> Calibration:
        """Calibration of all cameras, for an exporter that requires it."""
        assert self.calibration is not None, "it is checked before anything is written"
        return self.calibration

    def mask_folder(self, masks: Path, camera: str) -> Path:
        """Return the folder of a camera's masks, paired by its label; what was paired is said once."""
        if not self._mask_folders:
            labels = sorted(folder.name for folder in masks.glob("*/"))
            called = self.session.stored_manifest.labels
            self._mask_folders = pair_labels(labels, called)
            if said := describe_pairs(str(masks), self._mask_folders, labels, called):
                self.warn(said)
        return masks / self._mask_folders.get(camera, camera)

    def warn(self, note: str) -> None:
        """Add a note that the user should read before anything is written."""
        self.notes.append(note)
        self.on_warning(note)

    def put(self, image: ImageRecord, file: str, frame: int = 0) -> None:
        """Record the place of an image in the export."""
        self.frames[image.camera, image.instant] = file, frame, image

    def images_of(self, camera: str) -> list[ImageRecord]:
        """Return a camera's images in order, each once even if it also substitutes for a dropped frame."""
        groups = (
            list(images) for _, images in groupby(self._in_order(camera), key=lambda image: image.leader_ns)
        )
        return [next((image for image in group if not image.substitute), group[-1]) for group in groups]

    def image_at(self, camera: str, instant: int) -> ImageRecord | None:
        """Return the image that was taken at an instant, or None if it is missing or a substitute."""
        image = self.images.get((camera, instant))
        return None if image is None or image.substitute else image

    def complete_instants(self) -> list[int]:
        """Return the instants for which every camera has an image."""
        return [
            instant
            for instant in range(len(self.instants_ns))
            if all(self.image_at(camera, instant) for camera in self.cameras)
        ]

    def size(self, camera: str) -> tuple[int, int]:
        """Return width and height in px of a camera's images."""
        facts = self.session.camera(camera).facts
        return facts.width, facts.height

    def load(self, image: ImageRecord, redraw: Redraw | None = None) -> tuple[bytes, Picture]:
        """Return an image's file bytes and its pixels: height x width x BGR of 8 bits, EXIF not applied.

        The pixels are redrawn by `redraw`, if given. Raises as `read`, and BadInputError if it cannot be
        decoded.
        """
        data = self.read(image)
        if (pixels := decode_image(data, colour=True)) is None:
            path = self.session.image_file(image)
            raise BadInputError(f"{path} is not an image that can be decoded", hint=RESTORE_IMAGE)
        return data, (redraw(pixels) if redraw else pixels)

    def read(self, image: ImageRecord) -> bytes:
        """Return an image's file bytes without decoding them.

        Raises IncompleteError if the file is missing; BadInputError if it differs from what was saved, or has
        a different size than its camera.
        """
        path = self.session.image_file(image)
        try:
            data = self.session.image_bytes(image)
        except FileNotFoundError:
            raise IncompleteError(f"{path} is missing", hint=RESTORE_IMAGE) from None
        except OSError as error:
            raise BadInputError(f"cannot read {path}: {error.strerror}", hint=RESTORE_IMAGE) from error
        if len(data) != image.bytes or hashlib.sha256(data).hexdigest() != image.sha256:
            raise BadInputError(f"{path} is not the image that was saved", hint=RESTORE_IMAGE)
        self._done += 1
        self._progress(min(self._done, len(self.images)), len(self.images))
        width, height = self.size(image.camera)
        # An image of another size need not be decoded, and might not fit into memory.
        if (size := size_of(data)) not in (None, (width, height)):
            raise BadInputError(
                f"{path} is {size[0]}x{size[1]} pixels; {image.camera} takes {width}x{height}",
                hint=RESTORE_IMAGE,
            )
        return data

    def write_image(
        self, image: ImageRecord, folder: Path, file: str, redraw: Redraw | None = None, frame: int = 0
    ) -> None:
        """Write an image into a folder, and `put` it: its bytes, or its pixels as PNG if the suffix needs it.

        A redrawn image is JPEG of quality 98, or PNG. Raises as `load` does if the file is not the image that
        was saved.
        """
        data, pixels = self.load(image, redraw)
        self.put(image, file, frame)
        target = folder / file
        target.parent.mkdir(parents=True, exist_ok=True)
        if redraw is not None or _ending(self, image) != target.suffix:
            target.write_bytes(encode_image(pixels, target.suffix, quality=98))
        elif self.link and not isinstance(image, FrameRecord):
            link_or_copy(str(self.session.image_file(image).resolve()), str(target))
        else:
            target.write_bytes(data)

    def _in_order(self, camera: str) -> list[ImageRecord]:
        places = ((camera, instant) for instant in range(len(self.instants_ns)))
        return [self.images[place] for place in places if place in self.images]


def _images_by_place(session: Session) -> dict[tuple[str, int], ImageRecord]:
    where = session.folder / MANIFEST
    images: dict[tuple[str, int], ImageRecord] = {}
    files: dict[tuple[Path, int], ImageRecord] = {}
    for image in session.manifest.images:
        first = images.setdefault((image.camera, image.instant), image)
        if first is not image or files.setdefault(session.image_place(image), image) is not image:
            raise BadInputError(f"{where} lists {image.path} of {image.camera} twice", hint=RESTORE)
    return images


def _check_times(burst: ExportedBurst) -> None:
    where = burst.session.folder / MANIFEST
    for index, (before_ns, after_ns) in enumerate(pairwise(burst.instants_ns), 1):
        if after_ns <= before_ns:
            raise BadInputError(f"{where}: instant {index} is not after instant {index - 1}", hint=RESTORE)
    for camera in burst.cameras:
        for last, image in pairwise(burst._in_order(camera)):
            shared = image.leader_ns == last.leader_ns and (image.substitute or last.substitute)
            if image.leader_ns <= last.leader_ns and not shared:
                raise BadInputError(
                    f"{where}: the times of {camera} go backwards at instant {image.instant}", hint=RESTORE
                )


def suffix_for(burst: ExportedBurst, images: list[ImageRecord]) -> str:
    """Return the file suffix for all of these images: their own, or .png if they differ."""
    endings = {_ending(burst, image) for image in images}
    return endings.pop() if len(endings) == 1 else ".png"


def jpeg_or_png(burst: ExportedBurst, image: ImageRecord) -> tuple[bytes, str]:
    """Return an image's own bytes if they are JPEG or PNG, otherwise its pixels as PNG; and `jpeg` or `png`.

    Raises as `ExportedBurst.load` does.
    """
    data, pixels = burst.load(image)
    kind = {".jpg": "jpeg", ".png": "png"}.get(_ending(burst, image))
    return (data, kind) if kind else (encode_image(pixels, ".png"), "png")


def _ending(burst: ExportedBurst, image: ImageRecord) -> str:
    ending = burst.session.image_file(image).suffix.lower()
    return _SAME.get(ending, ending)


def mask_path(folder: Path, camera: str, instant: int) -> Path:
    """Return the path of an image's mask in a folder of masks."""
    return folder / camera / f"{instant:06d}.png"


def write_mask(
    burst: ExportedBurst,
    masks: Path | None,
    image: ImageRecord,
    target: Path,
    *,
    movers: int,
    redraw: Redraw | None = None,
) -> None:
    """Write an image's mask from the folder `masks`, if given; `movers` (0 or 255) marks moving regions.

    Raises IncompleteError if the folder lacks it, BadInputError if its size differs from the image's.
    """
    import cv2

    if masks is None:
        return
    folder = burst.mask_folder(masks, image.camera)
    path = mask_path(folder.parent, folder.name, image.instant)
    if not path.is_file():
        raise IncompleteError(f"{path} is missing", hint="reconstruct movers makes masks of all images")
    width, height = burst.size(image.camera)
    mask = decode_image(read_regular(path), colour=True, max_pixels=width * height)
    if mask is None or mask.shape[:2] != (height, width):
        raise BadInputError(
            f"{path} is not a picture of {width}x{height} pixels",
            hint="reconstruct movers makes masks of the images' size",
        )
    drawn = redraw(mask) if redraw else mask
    white: Picture = np.where(cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY) > 127, 255, 0).astype(np.uint8)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(encode_image(white if movers else 255 - white, ".png"))

"""Panel times of all images of a session, next to the session's own timestamps."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations, groupby

from capture_app.common.errors import NotApplicableError
from capture_app.companions.panel.camera_reading import CameraReading
from capture_app.companions.panel.finder import PanelNotFoundError
from capture_app.companions.panel.pattern import Panel
from capture_app.companions.panel.time_reading import PanelTime
from capture_app.session.format.manifest import CameraRecord, ImageRecord, row_exposures
from capture_app.session.reading.decoding import decode_image
from capture_app.session.reading.reader import Session


@dataclass(frozen=True, slots=True)
class PictureTime:
    """Mid-exposure time of an image's middle row, by the panel and by the session, in ns."""

    image: ImageRecord
    panel_ns: float
    """Panel time, modulo the cycle."""
    uncertainty_ns: float
    """95 % uncertainty of the reading."""
    stamp_ns: int
    """Session timestamp, in the leader's clock."""
    true_ns: int | None
    """True time, in a simulated session."""
    reading: PanelTime
    row: float
    """The image's middle row."""


@dataclass(frozen=True, slots=True)
class SessionTimes:
    """Panel readings of a session's images."""

    panel: Panel
    cameras: tuple[str, ...]
    pictures: tuple[PictureTime, ...]
    refusals: tuple[tuple[ImageRecord, str], ...]
    """Images whose panel could not be read, with the reason."""
    exposures_known: bool
    """Whether the session gives exposures and row times, so that timestamps and panel times mean the same
    moment."""


def read_session(
    session: Session, done: Callable[[int, int], None] = lambda _done, _of: None
) -> SessionTimes:
    """Read the panel in every image of a session; `done` is called with the images read and their total.

    Raises NotApplicableError if no image shows a readable panel.
    """
    images = sorted(session.manifest.images, key=lambda image: (image.camera, image.instant))
    known = all(row_exposures(session.camera(image.camera), image) for image in images)
    true_times = session.true_times()
    truth = (
        {}
        if true_times is None
        else {(record.camera, record.instant): record.true_ns for record in true_times.images}
    )
    pictures: list[PictureTime] = []
    refusals: list[tuple[ImageRecord, str]] = []
    readings: defaultdict[str, CameraReading] = defaultdict(CameraReading)
    for number, image in enumerate(images):
        camera = session.camera(image.camera)
        try:
            read = _read(session, camera, image, readings[image.camera])
        except PanelNotFoundError as error:
            refusals.append((image, str(error)))
        else:
            row, rows = (camera.facts.height - 1) / 2, row_exposures(camera, image)
            panel_ns, uncertainty_ns = read.at_row(row)
            true_ns = truth.get((image.camera, image.instant))
            later_ns = round(read.shutter.exposure_ns / 2 + row * read.shutter.row_time_ns)
            pictures.append(
                PictureTime(
                    image=image,
                    panel_ns=panel_ns % read.panel.cycle_ns,
                    uncertainty_ns=uncertainty_ns,
                    stamp_ns=round(rows.first_start_ns + row * rows.row_time_ns + rows.exposure_ns / 2)
                    if known and rows is not None
                    else image.leader_ns,
                    true_ns=None if true_ns is None else true_ns + later_ns,
                    reading=read,
                    row=row,
                )
            )
        done(number + 1, len(images))
    if not pictures:
        reasons = sorted({reason for _, reason in refusals})
        raise NotApplicableError(
            f"no picture of {session.folder} shows a panel's time: {'; '.join(reasons[:3])}",
            hint="capture-app panel show draws one on a screen; all its four markers must be seen, sharp",
        )
    panels = [picture.reading.panel for picture in pictures]
    panel = max(panels, key=panels.count)
    refusals += [
        (picture.image, f"it shows another panel, {picture.reading.panel.name}")
        for picture in pictures
        if picture.reading.panel != panel
    ]
    return SessionTimes(
        panel=panel,
        cameras=tuple(camera.name for camera in session.manifest.cameras),
        pictures=tuple(picture for picture in pictures if picture.reading.panel == panel),
        refusals=tuple(refusals),
        exposures_known=known,
    )


def _read(session: Session, camera: CameraRecord, image: ImageRecord, reading: CameraReading) -> PanelTime:
    """Read an image's panel. Raises PanelNotFoundError if it cannot be read."""
    picture = decode_image(session.image_bytes(image), colour=True)
    if picture is None:
        raise PanelNotFoundError("the picture cannot be decoded")
    return reading.read(
        picture,
        exposure_ns=image.exposure_ns or camera.facts.exposure_ns,
        row_time_ns=camera.facts.row_time_ns,
    )


def pairs(times: SessionTimes) -> "Iterator[tuple[PictureTime, PictureTime]]":
    """Yield the pairs of images of the same instant by two cameras, cameras in the session's order."""
    pictures = sorted(
        times.pictures, key=lambda picture: (picture.image.instant, times.cameras.index(picture.image.camera))
    )
    for _, some in groupby(pictures, key=lambda picture: picture.image.instant):
        yield from combinations(some, 2)

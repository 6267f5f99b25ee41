"""A take as a table, cameras across and instants down, and its pictures: contact sheet and animation."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Self

import msgspec

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.common.names import natural_order
from capture_app.common.text import Progress, count, duration
from capture_app.session.format.manifest import ImageRecord, inside
from capture_app.session.reading.decoding import decode_image
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import judge

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Picture = NDArray[np.uint8]

GAP, HEAD, GUTTER = 6, 26, 84
GROUND, INK, MUTED, WARNING = (31, 23, 22), (232, 208, 200), (150, 130, 120), (104, 175, 224)
"""Colours, BGR."""
MAX_PIXELS = 100_000_000
MAX_SIDE = 65_500
"""Maximum height and width of a JPEG that libjpeg writes, px."""
MAX_HEIGHT = 16_383
"""Height from which a sheet continues beside itself, px: browsers and many viewers show no taller picture."""
PAIR_DEPTH = "pair.png"
"""Picture of two cameras' depth in the folder of a result, until all cameras' depth is done."""


def arc_order(session: Session) -> tuple[str, ...]:
    """Return the camera names in the order of their arc around the subject; sorted by name without poses.

    Raises BadInputError if the session's calibration is malformed.
    """
    names = sorted((camera.name for camera in session.manifest.cameras), key=natural_order)
    calibration = session.calibration()
    if calibration is None or not all(name in calibration.cameras for name in names):
        return tuple(names)
    from capture_app.session.format.camera_order import order_on_arc  # heavy: only if there are poses

    return order_on_arc({name: calibration.cameras[name] for name in names})


class TakeSheet:
    """A session's images by camera and instant."""

    def __init__(self, session: Session) -> None:
        """Read the camera order of a session. Raises BadInputError if its calibration is malformed."""
        self.session = session
        self.verdict = judge(session.manifest, arriving=session.is_arriving)
        self.cameras = tuple(sorted((camera.name for camera in session.manifest.cameras), key=natural_order))
        self.arc = arc_order(session)
        """Cameras in the order of their arc, for pictures in motion."""
        self._images = {(image.camera, image.instant): image for image in session.manifest.images}
        self._missing = {
            (absence.camera, absence.instant): absence.reason for absence in session.manifest.missing
        }

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
        return max(camera.facts.height / camera.facts.width for camera in self.session.manifest.cameras)

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
        if (image := self.image(camera, instant)) is None:
            return self._missing.get((camera, instant), "missing")
        beside = "neighbouring frame" if image.substitute else ""
        return f"{duration(image.residual_ns, signed=True)} off" if image.late else beside

    def heading(self, camera: str) -> str:
        """Return what people call a camera, in a staggered session with its planned delay."""
        manifest, delay_ns = self.session.stored_manifest, self.session.camera(camera).delay_ns
        return manifest.labels[camera] + (f" +{delay_ns / 1e6:.3g} ms" if manifest.is_staggered else "")

    def since_start_ns(self, instant: int) -> int:
        """Return the time of an instant since the first one, ns."""
        instants_ns = self.session.manifest.burst.instants_ns
        return instants_ns[instant] - instants_ns[0]

    def spread_ns(self, instant: int) -> int | None:
        """Return the time from the first to the last image of an instant, ns; None for fewer than two.

        Planned delays are not counted.
        """
        times = [
            image.leader_ns - self.session.camera(camera).delay_ns
            for camera in self.cameras
            if (image := self.image(camera, instant))
        ]
        return max(times) - min(times) if len(times) > 1 else None

    def load(self, camera: str, instant: int, width: int = 0) -> "Picture | None":
        """Decode an image (height x width x BGR), at least `width` px wide if possible; 0 for full size.

        Returns None if it is missing or unreadable. Blocks on the disk.
        """
        image = self.image(camera, instant)
        try:
            data = b"" if image is None else self.session.image_bytes(image)
        except OSError:
            return None
        return decode_image(data, colour=True, min_width=width)


def sheet_instants(sheet: TakeSheet, width: int) -> range:
    """Return the instants of a contact sheet: all, or every Nth of a take that is too long for a picture."""
    tallest_px = min(MAX_SIDE, MAX_PIXELS // (GUTTER + len(sheet.cameras) * (width + GAP)))
    rows = (tallest_px - HEAD) // (round(width * sheet.aspect) + GAP)
    return range(0, sheet.instants, math.ceil(sheet.instants / max(1, rows)))


def contact_sheet(
    sheet: TakeSheet,
    width: int,
    progress: Progress = lambda done, total: None,
    instants: Sequence[int] | None = None,
) -> "Picture":
    """Draw a contact sheet: a column per camera, a row per instant, each image `width` px wide; returns BGR.

    Rows that do not fit into the height continue in further columns. `instants` are the rows; None:
    `sheet_instants`. Raises BadInputError if the sheet would exceed
    100 megapixels, or 65,500 px on a side.
    """
    import cv2
    import numpy as np

    height = round(width * sheet.aspect)
    instants = sheet_instants(sheet, width) if instants is None else instants
    across, wide = len(sheet.cameras), GUTTER + len(sheet.cameras) * (width + GAP)
    blocks = max(1, math.ceil(len(instants) / max(1, (MAX_HEIGHT - HEAD) // (height + GAP))))
    down = math.ceil(len(instants) / blocks)
    size = HEAD + down * (height + GAP), blocks * wide
    if (HEAD + len(instants) * (height + GAP)) * wide > MAX_PIXELS or max(size) > MAX_SIDE:
        raise BadInputError(
            f"a sheet of {across} x {len(instants)} pictures would have {size[1]} x {size[0]} pixels",
            hint="choose a smaller --width",
        )
    whole = np.full((*size, 3), GROUND, np.uint8)
    for x, camera in enumerate(sheet.cameras * blocks):
        # OpenCV's font only has ASCII.
        heading = sheet.heading(camera)
        left = x // across * wide + GUTTER + x % across * (width + GAP)
        _write(whole, heading if heading.isascii() else camera, (left, 18), INK, room=width)
    for y, instant in enumerate(instants):
        top, start = HEAD + y % down * (height + GAP), y // down * wide
        since = duration(sheet.since_start_ns(instant), signed=True) if instant else "first"
        _write(whole, since, (start + 6, top + 16), INK, room=GUTTER - 8)
        _write(whole, duration(sheet.spread_ns(instant)), (start + 6, top + 34), MUTED, room=GUTTER - 8)
        for x, camera in enumerate(sheet.cameras):
            left = start + GUTTER + x * (width + GAP)
            if (image := sheet.load(camera, instant, width)) is not None:
                scaled = fit(image, width, height)
                whole[top : top + scaled.shape[0], left : left + scaled.shape[1]] = scaled
            if note := sheet.note(camera, instant) or ("" if image is not None else "cannot be read"):
                cv2.rectangle(whole, (left, top), (left + width - 1, top + height - 1), WARNING, 1)
                _write(whole, note, (left + 4, top + height - 6), WARNING, room=width - 8)
            progress(y * across + x + 1, across * down)
    return whole


def wiggle_frames(sheet: TakeSheet, instant: int, width: int) -> "list[Picture]":
    """Return the images of an instant in the order of the cameras' arc, in one size; skip missing ones.

    Raises BadInputError if the take has no such instant, or fewer than two intact images of it.
    """
    images = [image for camera in sheet.arc if (image := sheet.load(camera, instant, width)) is not None]
    frames = [fit_canvas(image, width, round(width * sheet.aspect)) for image in images]
    if len(frames) < 2:
        raise BadInputError(
            f"{sheet.session.folder} has {count(len(frames), 'picture')} of instant {instant} that can be "
            "read; a wiggle needs two",
            hint="choose another --instant",
        )
    return frames


def encode_animation(frames: "list[Picture]", suffix: str, step_ms: int, rest_ms: int) -> bytes:
    """Encode an endless back-and-forth animation as .gif or .webp; the first and last frame last `rest_ms`.

    Raises NotAvailableError if this build of OpenCV cannot write the format.
    """
    import cv2

    animation = cv2.Animation()
    animation.frames = [*frames, *frames[-2:0:-1]]
    steps = [step_ms] * (len(frames) - 2)
    animation.durations = [rest_ms, *steps, rest_ms, *steps]
    animation.loop_count = 0
    # On a sample these settings give 30.5 dB as GIF (OpenCV's defaults: 21.4), and 31.6 dB as WebP in half
    # the bytes.
    options = {
        ".gif": [cv2.IMWRITE_GIF_DITHER, 3, cv2.IMWRITE_GIF_QUALITY, 8],
        ".webp": [cv2.IMWRITE_WEBP_QUALITY, 80],
    }
    made, data = cv2.imencodeanimation(suffix, animation, options[suffix])
    if not made:
        raise NotAvailableError(f"this OpenCV cannot write {suffix}", hint="install opencv-python-headless 5")
    return bytes(data.tobytes())


def depth_picture(result: Path) -> bytes:
    """Return the depth image of the reference camera, from a result's `multiview.json`.

    Raises OSError, LookupError, ValueError, TypeError or BadInputError for a result that has none.
    """
    found = msgspec.json.decode(result.read_bytes())
    views = {view["camera"]: view["picture"] for view in found["views"]}
    return inside(result.parent, views[found["reference"]]).read_bytes()


def fit(image: "Picture", width: int, height: int) -> "Picture":
    """Scale the image to the largest size that fits into `width` x `height` px."""
    import cv2
    import numpy as np

    scale = min(width / image.shape[1], height / image.shape[0])
    size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def fit_canvas(
    image: "Picture", width: int, height: int, ground: tuple[int, int, int] = (0, 0, 0)
) -> "Picture":
    """Scale the image to fit a canvas of `width` x `height` px, centred, with `ground` (BGR) around it."""
    import numpy as np

    fitted, canvas = fit(image, width, height), np.full((height, width, 3), ground, np.uint8)
    top, left = (height - fitted.shape[0]) // 2, (width - fitted.shape[1]) // 2
    canvas[top : top + fitted.shape[0], left : left + fitted.shape[1]] = fitted
    return canvas


def _write(
    whole: "Picture", text: str, at: tuple[int, int], colour: tuple[int, int, int], *, room: int
) -> None:
    """Draw as much of the text as fits, in OpenCV's font, which only has ASCII."""
    import cv2

    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.45
    ascii_text = text.replace("µ", "u").encode("ascii", "replace").decode()
    while ascii_text and cv2.getTextSize(ascii_text, font, size, 1)[0][0] > room:
        ascii_text = ascii_text[:-1]
    cv2.putText(whole, ascii_text, at, font, size, colour, 1, cv2.LINE_AA)

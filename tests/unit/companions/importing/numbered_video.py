"""Videos whose frames show their numbers, and what a session made of them."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.recording import import_found
from capture_app.session.reading.reader import Session

MS, US = 1_000_000, 1_000
IRREGULAR_US = (0, 33_400, 66_001, 140_000, 166_667, 200_123)


def write_video(path: Path, times_us: Sequence[int], *, first: int = 0, interlaced: bool = False) -> Path:
    """A video whose frame n is shown at its own time and is 20 n grey levels bright, n from `first`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w", options={"movie_timescale": "1000000"}) as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        fields = {"x264-params": "tff=1"} if interlaced else dict[str, str]()
        stream.options = {"bf": "2", "crf": "10", **fields}
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1_000_000)
        for number, at_us in enumerate(times_us, first):
            frame = av.VideoFrame.from_ndarray(
                np.full((48, 64, 3), 20 + 20 * number, np.uint8), format="bgr24"
            )
            frame.pts, frame.time_base = at_us, stream.time_base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def numbers_of(session: Session) -> list[dict[str, int]]:
    """By instant and camera, the number of the frame that an image shows."""
    found = []
    for images in session.images_by_instant():
        pictures = {name: cv2.imread(str(session.image_file(record))) for name, record in images.items()}
        found.append(
            {name: round((float(np.mean(p)) - 20) / 20) for name, p in pictures.items() if p is not None}
        )
    return found


def times_of(session: Session, camera: str) -> list[int]:
    return [record.leader_ns for record in session.manifest.images if record.camera == camera]


def imported(folder: Path, **options: object) -> tuple[Session, str]:
    """The session of the only recording in a folder, without alignment, and what was said of it."""
    said: list[str] = []
    chosen = ImportOptions(align="none", **options)  # type: ignore[arg-type]
    (session,) = import_found([str(folder)], folder.parent / "out", "s", chosen, talk=said.append)
    return session, "\n".join(said)

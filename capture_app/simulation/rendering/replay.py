"""The pictures of a simulated camera out of an MJPEG file: a real camera's load without the camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.errors import BadInputError
from capture_app.session.reading.decoding import decode_image, told_size
from capture_app.simulation.devices.sensor import SensorFrame
from capture_app.simulation.rendering.picture_source import PictureSource

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_BYTES = 1 << 28
_END, _START = b"\xff\xd9", b"\xff\xd8"


@dataclass(frozen=True, slots=True)
class Replay(PictureSource):
    """The JPEGs of a file, one after the other and again from the first, each as it is in the file."""

    jpegs: tuple[bytes, ...]

    @classmethod
    def open(cls, path: Path) -> Replay:
        """Read a file of JPEGs, one behind the other, as recordings have them.

        Raises BadInputError where it cannot be read, is too large to keep in memory, or is no such file.
        """
        try:
            size = path.stat().st_size
            data = b"" if size > MOST_BYTES else path.read_bytes()
        except OSError as error:
            raise BadInputError(f"cannot read {path}: {error.strerror}") from error
        if size > MOST_BYTES:
            raise BadInputError(f"{path} is larger than {MOST_BYTES >> 20} MB", hint="replay a part of it")
        parts = data.split(_END + _START)
        starts = [b"", *[_START] * (len(parts) - 1)]
        ends = [*[_END] * (len(parts) - 1), b""]
        jpegs = tuple(start + part + end for start, part, end in zip(starts, parts, ends, strict=True))
        sizes = {told_size(jpeg) for jpeg in jpegs}
        known = sizes.pop()
        if known is None or sizes:
            raise BadInputError(f"{path} does not hold JPEGs of one size, one behind the other")
        return cls(*known, jpegs)

    def jpeg(self, frame: SensorFrame) -> bytes | None:
        """Return the next of the file's, a copy as a driver makes one of its buffer."""
        return bytes(bytearray(self.jpegs[frame.sequence % len(self.jpegs)]))

    def render(self, frame: SensorFrame, *, seed: int) -> NDArray[np.uint8]:
        """Return the picture decoded, BGR uint8 of height x width x 3."""
        import numpy as np

        picture = decode_image(self.jpegs[frame.sequence % len(self.jpegs)], colour=True)
        return np.zeros((self.height, self.width, 3), np.uint8) if picture is None else picture

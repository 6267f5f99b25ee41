"""The pictures of machine-vision cameras: grey, Bayer and colour, as they lay in the buffer."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_JPEG_QUALITY = 95
_CONVERSIONS = {
    "BayerRG": "COLOR_BayerRGGB2BGR",
    "BayerGR": "COLOR_BayerGRBG2BGR",
    "BayerGB": "COLOR_BayerGBRG2BGR",
    "BayerBG": "COLOR_BayerBGGR2BGR",
}
"""OpenCV's names of the patterns as GenICam's have them: by the first two pixels of the first row."""

USABLE_FORMATS = (
    *(f"{layout}8" for layout in (*_CONVERSIONS, "RGB", "BGR", "Mono")),
    *(f"{layout}{bits}" for layout in (*_CONVERSIONS, "Mono") for bits in (16, 12, 10)),
)
"""The pixel formats that can be saved, the best first; more than 8 bits lie in 16 each."""


@dataclass(frozen=True, slots=True)
class MachinePicture:
    """A picture as the camera sent it; `pixel_format` is GenICam's name."""

    data: bytes
    width: int
    height: int
    pixel_format: str

    @property
    def held_bytes(self) -> int:
        """How much memory it takes."""
        return len(self.data)

    def encode(self) -> bytes:
        """Return a JPEG of quality 95."""
        import cv2

        _done, jpeg = cv2.imencode(".jpg", self._picture(), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        return bytes(jpeg)

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Return the picture, BGR uint8 (H, W, 3), of every so-manieth pixel."""
        import cv2
        import numpy as np

        step = max(1, self.width // max(width, 1))
        picture = self._picture()[::step, ::step]
        if picture.ndim == 2:
            picture = np.asarray(cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_GRAY2BGR), np.uint8)
        return picture

    def _picture(self) -> "NDArray[np.uint8]":
        """The picture of 8 bits, BGR or grey."""
        import cv2
        import numpy as np

        layout, bits = split_format(self.pixel_format)
        channels = 3 if layout in ("RGB", "BGR") else 1
        shape = (self.height, self.width, 3) if channels == 3 else (self.height, self.width)
        kind = np.dtype("u1" if bits == 8 else "<u2")
        flat = np.frombuffer(self.data, kind, self.width * self.height * channels)
        pixels = flat.reshape(shape)
        picture = pixels if bits == 8 else (pixels >> (bits - 8)).astype(np.uint8)
        if layout == "RGB":
            picture = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        elif layout in _CONVERSIONS:
            picture = cv2.cvtColor(picture, getattr(cv2, _CONVERSIONS[layout]))
        return np.asarray(picture, np.uint8)


def split_format(pixel_format: str) -> tuple[str, int]:
    """The layout and the bits of a usable format's name, such as BayerRG and 12."""
    layout = pixel_format.rstrip("0123456789")
    return layout, int(pixel_format[len(layout) :])

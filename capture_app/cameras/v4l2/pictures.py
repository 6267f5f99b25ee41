"""The pictures of a V4L2 camera, copied out of the driver's buffers: its own JPEG, or raw pixels."""

from dataclasses import dataclass

from capture_app.cameras.v4l2.layout import PixelFormat

_JPEG_QUALITY = 95
_JPEG_START = b"\xff\xd8"


@dataclass(frozen=True, slots=True)
class JpegPicture:
    """A JPEG as the camera made it."""

    data: bytes

    def encode(self) -> bytes:
        """Return the camera's own bytes."""
        return self.data


@dataclass(frozen=True, slots=True)
class RawPicture:
    """An uncompressed picture as it lay in the driver's buffer."""

    data: bytes
    layout: PixelFormat

    def encode(self) -> bytes:
        """Return a JPEG of quality 95."""
        import cv2
        import numpy as np

        width, height, stride = self.layout.width, self.layout.height, self.layout.bytes_per_line
        rows = _rows(self.layout)
        plane = np.frombuffer(self.data, np.uint8, rows * stride).reshape(rows, stride)
        if self.layout.fourcc == "YUYV":
            picture = cv2.cvtColor(plane[:, : 2 * width].reshape(height, width, 2), cv2.COLOR_YUV2BGR_YUYV)
        elif self.layout.fourcc == "NV12":
            picture = cv2.cvtColor(np.ascontiguousarray(plane[:, :width]), cv2.COLOR_YUV2BGR_NV12)
        else:
            picture = plane[:, :width]
        _done, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        return bytes(jpeg)


def picture_from_buffer(data: bytes, layout: PixelFormat) -> JpegPicture | RawPicture | None:
    """The picture of a buffer's bytes; None where they cannot be a picture of that format."""
    if layout.fourcc in ("MJPG", "JPEG"):
        return JpegPicture(data) if data.startswith(_JPEG_START) else None
    return RawPicture(data, layout) if len(data) >= layout.bytes_per_line * _rows(layout) else None


def _rows(layout: PixelFormat) -> int:
    return layout.height * 3 // 2 if layout.fourcc == "NV12" else layout.height

"""What a camera of libcamera is asked for, and how it is configured."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capture_app.cameras.options import refuse_unknown
from capture_app.cameras.v4l2.layout import PixelFormat
from capture_app.errors import BadInputError, CameraError

FOURCC = {"MJPEG": "MJPG", "NV12": "NV12", "YUYV": "YUYV", "R8": "GREY"}
"""The library's formats that can be saved, the best first, and what V4L2 calls them."""
DEFAULT_SIZE = (640, 480)
DEFAULT_FPS = 30.0
BUFFERS = 6
"""A process that is held up for as many frames loses none; a command takes effect after as many."""
_RANGES = {
    "width": (1, 65535),
    "height": (1, 65535),
    "fps": (0.001, 10_000.0),
    "exposure-us": (1, 60_000_000),
    "gain": (0.1, 1000.0),
}


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a user asked for; None where the camera's own choice will do. Pixels, frames/s, us."""

    width: int | None = None
    height: int | None = None
    fps: float | None = None
    fourcc: str | None = None
    exposure_us: int | None = None
    gain: float | None = None

    @property
    def size(self) -> tuple[int, int]:
        """The size to ask for, in the usual shape where only one side is given."""
        width, height = self.width, self.height
        if width is not None:
            return width, height if height is not None else round(width * 3 / 4)
        return (round(height * 4 / 3), height) if height is not None else DEFAULT_SIZE

    @property
    def period_us(self) -> int:
        """The frame period to ask for."""
        return round(1e6 / (self.fps or DEFAULT_FPS))


def parse_options(options: Mapping[str, str]) -> Wishes:
    """Read width, height, fps, format, exposure-us and gain. Raises BadInputError, naming the wrong one."""
    refuse_unknown(options, (*_RANGES, "format"), "a camera of libcamera")
    numbers = {name: _number(name, options[name]) for name in _RANGES if name in options}
    fourcc = options.get("format", "").upper()
    fourcc = FOURCC.get(fourcc, fourcc)
    if fourcc and fourcc not in FOURCC.values():
        raise BadInputError(
            f"format={options['format']} cannot be saved", hint=f"there are {', '.join(FOURCC.values())}"
        )
    whole = {name: None if name not in numbers else int(numbers[name]) for name in _RANGES}
    return Wishes(
        width=whole["width"],
        height=whole["height"],
        fps=numbers.get("fps"),
        fourcc=fourcc or None,
        exposure_us=whole["exposure-us"],
        gain=numbers.get("gain"),
    )


def configure(module: Any, camera: Any, wishes: Wishes) -> tuple[Any, PixelFormat]:
    """Configure an acquired camera; returns its stream and how a picture lies in memory.

    Raises CameraError, with what it offers, where it has no such mode.
    """
    name = camera.id
    configuration = camera.generate_configuration([module.StreamRole.VideoRecording])
    if configuration is None or configuration.size == 0:
        raise CameraError(f"{name} delivers no video", hint="`capture-app cameras` lists the cameras")
    stream = configuration.at(0)
    offered = [str(one) for one in stream.formats.pixel_formats]
    formats = [one for one in FOURCC if one in offered and wishes.fourcc in (None, FOURCC[one])]
    if not formats:
        asked = wishes.fourcc or "a format that can be saved"
        raise CameraError(f"{name} does not offer {asked}", hint=f"it offers {', '.join(offered)}")
    stream.pixel_format = module.PixelFormat(formats[0])
    stream.size = module.Size(*wishes.size)
    stream.buffer_count = max(stream.buffer_count, BUFFERS)
    if configuration.validate() == module.CameraConfiguration.Status.Invalid:
        raise CameraError(f"{name} has no mode {formats[0]} {_text(wishes.size)}")
    width, height = stream.size.width, stream.size.height
    if wishes.width not in (None, width) or wishes.height not in (None, height):
        raise CameraError(
            f"{name} has no mode {formats[0]} {_text(wishes.size)}",
            hint=f"the nearest is width={width},height={height}",
        )
    if str(stream.pixel_format) not in FOURCC:
        raise CameraError(f"{name} does not offer {formats[0]} in {_text((width, height))}")
    camera.configure(configuration)
    fourcc = FOURCC[str(stream.pixel_format)]
    return stream, PixelFormat(fourcc, width, height, stream.stride, stream.frame_size)


def _number(name: str, text: str) -> float:
    least, most = _RANGES[name]
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not least <= number <= most or (isinstance(least, int) and number != int(number)):
        raise BadInputError(f"{name}={text} is out of range ({least:g} to {most:g})")
    return number


def _text(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"

"""Modes that a V4L2 camera offers, and the choice among them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import starmap

from capture_app.cameras.frames import PixelFormat
from capture_app.cameras.specs import DEFAULT_SIZE, CameraRequest, read_request
from capture_app.common.errors import CameraError
from capture_app.plugins.cameras.v4l2 import kernel as v4l2
from capture_app.plugins.cameras.v4l2.kernel import VideoDevice

USABLE_FORMATS = ("MJPG", "JPEG", "YUYV", "NV12", "GREY")
"""Pixel formats that can be saved, best first: a camera's own JPEG is the smallest on the bus."""

DEFAULT_PERIOD = Fraction(1, 30)
_LISTED_MODES = 8
_RATE_TOLERANCE = 0.01
"""Relative tolerance: drivers round frame rates, and 29.97 and 30 fps are one mode to a user."""


@dataclass(frozen=True, slots=True)
class Mode:
    """A format and size that a camera offers, with its frame periods; empty if it does not report them."""

    fourcc: str
    width: int
    height: int
    intervals: tuple[tuple[Fraction, Fraction], ...] = ()
    """Shortest and longest period in seconds of each range; equal for a single period."""

    def nearest_period(self, request: Fraction) -> Fraction:
        """Return the offered frame period in seconds nearest to the requested one."""
        offered = (min(max(request, shortest), longest) for shortest, longest in self.intervals)
        return min(offered, key=lambda period: abs(period - request), default=request)

    def __str__(self) -> str:
        rates = ", ".join(starmap(_rates, self.intervals))
        return f"{self.fourcc} {self.width}x{self.height}" + (f" at {rates} fps" if rates else "")


def parse_options(options: Mapping[str, str]) -> CameraRequest:
    """Read the options width, height (pixels), fps and format. Raises BadInputError naming the wrong one."""
    asked = read_request(options, "a V4L2 camera")
    return asked if asked.format is None else replace(asked, format=asked.format.upper())


def check_capture(path: str, model: str, flags: int) -> None:
    """Raise CameraError if a device node with these CAP_ bits does not deliver usable images."""
    needed = v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_STREAMING
    if flags & needed != needed:
        reasons = (
            (v4l2.CAP_META_CAPTURE, "carries metadata, not pictures"),
            (v4l2.CAP_VIDEO_CAPTURE_MPLANE, "delivers pictures in several planes, which is not supported"),
        )
        why = next((text for flag, text in reasons if flags & flag), "is not a capture device")
        raise CameraError(f"{path} ({model}) {why}", hint="`capture-app cameras` lists the cameras")


def offered_modes(device: VideoDevice, near_size: tuple[int, int] = DEFAULT_SIZE) -> tuple[Mode, ...]:
    """Return the usable modes of a camera; for a range of sizes the one nearest to `near_size` (pixels)."""
    sizes = dict.fromkeys(
        (fourcc, nearest_side(near_size[0], widths), nearest_side(near_size[1], heights))
        for fourcc in device.formats()
        if fourcc in USABLE_FORMATS
        for widths, heights in device.sizes(fourcc)
    )
    return tuple(Mode(*size, device.intervals(*size)) for size in sizes)


def nearest_side(target: int, offered: range) -> int:
    """Return the offered width or height (pixels) nearest to the requested one."""
    beyond = min(max(target, offered.start), offered.stop - 1) - offered.start
    return offered.start + (beyond + offered.step // 2) // offered.step * offered.step


def choose_mode(path: str, offered: tuple[Mode, ...], request: CameraRequest) -> tuple[Mode, Fraction]:
    """Return the best mode that satisfies the request, and its frame period in seconds.

    Without a request: MJPG before raw formats, near 640x480, near 30 fps. Raises CameraError that lists
    the camera's modes if none satisfies the request.
    """
    period = request.period_s or DEFAULT_PERIOD
    width, height = request.size
    if not offered:
        raise CameraError(
            f"{path} offers no format that can be saved",
            hint=f"supported formats: {', '.join(USABLE_FORMATS)}",
        )
    fitting = [
        mode
        for mode in offered
        if request.format in (None, mode.fourcc)
        and request.width in (None, mode.width)
        and request.height in (None, mode.height)
        and (request.period_s is None or same_period(mode.nearest_period(request.period_s), request.period_s))
    ]
    if not fitting:
        raise no_such_mode(path, request, offered)
    best = min(
        fitting,
        key=lambda mode: (
            USABLE_FORMATS.index(mode.fourcc),
            abs(mode.width * mode.height - width * height),
            abs(mode.nearest_period(period) - period),
        ),
    )
    return best, best.nearest_period(period)


def configure(device: VideoDevice, request: CameraRequest) -> tuple[PixelFormat, Fraction]:
    """Set a camera to the best requested mode; return its layout and its frame period in seconds.

    Raises CameraError if the camera does not offer it or sets another, OSError from the driver.
    """
    modes = offered_modes(device, request.size)
    mode, period = choose_mode(device.path, modes, request)
    taken = device.set_format(mode.fourcc, mode.width, mode.height)
    if (taken.fourcc, taken.width, taken.height) != (mode.fourcc, mode.width, mode.height):
        raise no_such_mode(device.path, request, modes)
    actual = device.set_period(period)
    if request.period_s is not None and actual is None:
        raise CameraError(f"{device.path} does not say at which rate it runs", hint="leave out fps")
    if request.period_s is not None and not same_period(actual or period, request.period_s):
        raise no_such_mode(device.path, request, modes)
    return taken, actual or period


def same_period(period: Fraction, other: Fraction) -> bool:
    """Return whether two frame periods are one mode to a user: they differ by less than 1 %."""
    return abs(period - other) < _RATE_TOLERANCE * other


def no_such_mode(path: str, request: CameraRequest, offered: tuple[Mode, ...]) -> CameraError:
    """Return the error for a missing mode, which lists the camera's modes."""
    lengths = {"width": request.width, "height": request.height}
    size = " ".join(f"of {side} {px}" for side, px in lengths.items() if px is not None)
    if None not in lengths.values():
        size = f"{request.width}x{request.height}"
    rate = "" if request.period_s is None else f"at {_fps(request.period_s)} fps"
    like = [mode for mode in offered if mode.fourcc == request.format] or list(offered)
    listed = "; ".join(str(mode) for mode in like[:_LISTED_MODES])
    more = f"; and {len(like) - _LISTED_MODES} more" if len(like) > _LISTED_MODES else ""
    asked = " ".join(filter(None, (request.format, size, rate)))
    return CameraError(f"{path} has no mode {asked}".rstrip(), hint=f"it offers {listed}{more}")


def _rates(shortest: Fraction, longest: Fraction) -> str:
    return _fps(shortest) if shortest == longest else f"{_fps(longest)} to {_fps(shortest)}"


def _fps(period: Fraction) -> str:
    return f"{float(1 / period):.4g}" if period else "any"

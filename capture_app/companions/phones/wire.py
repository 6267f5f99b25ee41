"""Messages between a phone's page and the gateway over their WebSocket.

Text messages are JSON. Binary messages are little-endian and begin with a byte for their kind:

1 ping      u32 number, u32 number of the last answered ping (all ones: none), f64 when that answer
            came, f64 now; answered by u8 1 and its number
2 frame     u32 id, u32 stream, f64 media time, f64 arrival, f64 capture time (NaN: not reported)
3 image     u32 id, the JPEG; empty if the phone no longer has it
4 preview   the same
5 sound     f64 arrival of the last sample, then mono samples of 16 bits at 48 kHz

Times are in us: media times have their own zero for each stream, all others are of the link worker's clock.
"""

import math
import struct
from dataclasses import dataclass
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from capture_app.common.bounds import Number
from capture_app.common.camera_facts import Control, ControlState

PING, FRAME, PICTURE, PREVIEW, SOUND = 1, 2, 3, 4, 5
_PING = struct.Struct("<BIIdd")
_PONG = struct.Struct("<BI")
_FRAME = struct.Struct("<BIIddd")
_PICTURE = struct.Struct("<BI")
_SOUND = struct.Struct("<Bd")
MAX_SOUND_BYTES = 1 << 17
_NONE = 0xFFFFFFFF
MAX_PICTURE_BYTES = 16 << 20
_LONGEST_US = 2.0**53

Words = Annotated[str, Meta(max_length=300)]
Pixels = Annotated[int, Meta(gt=0, le=16384)]


class PhoneHello(Struct, frozen=True, kw_only=True, tag_field="type", tag="hello"):
    """First message of a page's link: the page load, the browser, and the phone's model."""

    page: Words
    """Id of this page load: images of other loads are lost."""
    user_agent: Annotated[str, Meta(max_length=1000)] = ""
    model: Words = ""
    """The phone's model, if the browser reports it."""
    resolution_us: Annotated[float, Meta(ge=0.0, le=1e6)]
    """Step of the browser's clock."""


class Opened(Struct, frozen=True, kw_only=True, tag_field="type", tag="opened"):
    """The phone's camera has started to stream."""

    width: Pixels
    height: Pixels
    frame_rate: Annotated[float, Meta(ge=0.0, le=1000.0)] = 0.0
    """Frames per second as set in the browser; 0 if it states none."""
    label: Words = ""


class Controls(Struct, frozen=True, kw_only=True, tag_field="type", tag="controls"):
    """The camera's controls with their current values, in units that all cameras share."""

    controls: Annotated[tuple[ControlState, ...], Meta(max_length=len(Control))]
    answers: Number | None = None
    """Number of the order that this answers."""
    problem: Words = ""
    """Error if the order could not be carried out."""


class PageHidden(Struct, frozen=True, kw_only=True, tag_field="type", tag="page-hidden"):
    """The camera has stopped until it is opened again."""

    why: Words


@dataclass(frozen=True, slots=True)
class Ping:
    """A clock request; `answered` is the last answered ping's number, `received_us` when that answer came."""

    number: int
    answered: int | None
    received_us: float
    now_us: float


@dataclass(frozen=True, slots=True)
class FrameReport:
    """Report of a phone's frame; times in us."""

    id: int
    stream: int
    media_us: float
    arrived_us: float
    capture_us: float | None


@dataclass(frozen=True, slots=True)
class PictureBytes:
    """A frame's JPEG or its preview; no bytes if the phone no longer has it."""

    id: int
    is_preview: bool
    data: bytes


@dataclass(frozen=True, slots=True)
class SoundReport:
    """Samples of a phone's microphone, the last of which was taken just before `arrived_us`."""

    arrived_us: float
    pcm: bytes


Said = PhoneHello | Opened | Controls | PageHidden
_DECODER: msgspec.json.Decoder[Said] = msgspec.json.Decoder(PhoneHello | Opened | Controls | PageHidden)


def decode_text(text: str) -> Said:
    """Decode a page's JSON message. Raises ValueError."""
    return _DECODER.decode(text)


def decode_binary(data: bytes) -> Ping | FrameReport | PictureBytes | SoundReport:
    """Decode a page's binary message. Raises ValueError."""
    kind = data[0] if data else 0
    try:
        if kind == PING:
            _, number, answered, received_us, now_us = _PING.unpack(data)
            _check_times(received_us, now_us)
            return Ping(number, None if answered == _NONE else answered, received_us, now_us)
        if kind == FRAME:
            _, number, stream, media_us, arrived_us, capture_us = _FRAME.unpack(data)
            captured_us = None if math.isnan(capture_us) else capture_us
            _check_times(media_us, arrived_us, captured_us or 0.0)
            return FrameReport(number, stream, media_us, arrived_us, captured_us)
        if kind in (PICTURE, PREVIEW):
            _, number = _PICTURE.unpack_from(data)
            return PictureBytes(number, kind == PREVIEW, data[_PICTURE.size :])
        if kind == SOUND:
            _, arrived_us = _SOUND.unpack_from(data)
            _check_times(arrived_us)
            if len(data) % 2 == 0 or len(data) > MAX_SOUND_BYTES:
                raise ValueError(f"{len(data)} bytes of sound")
            return SoundReport(arrived_us, data[_SOUND.size :])
    except struct.error as error:
        raise ValueError(f"a message of kind {kind} with {len(data)} bytes") from error
    raise ValueError(f"there is no message of kind {kind}")


def pong(number: int) -> bytes:
    """Return the answer to a ping."""
    return _PONG.pack(PING, number)


def order(kind: str, **fields: object) -> str:
    """Return a JSON message to the page.

    picture    id: request a frame's image; preview: id, width in pixels of a small one
    control    number, control, value: set it to a fixed value; null lets the camera choose it
    restart    at_us: stop the camera, and start it at that time of the link worker's clock
    state      name, state, words, clock: what the page shows of its camera
    """
    return msgspec.json.encode({"type": kind, **fields}).decode()


def _check_times(*times_us: float) -> None:
    if not all(abs(time_us) < _LONGEST_US for time_us in times_us):
        raise ValueError("a time out of range")

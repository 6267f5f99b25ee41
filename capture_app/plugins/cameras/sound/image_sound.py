"""Sound within JPEG images: APP9 segments, which image programs skip, before the image's own tables.

A segment holds `_NAME`, then little-endian: u32 stream, u64 first sample, u32 rate in Hz, u8 channels;
i64 time of the first sample in ns of the node's clock, as `ImageRecord.local_ns`; and signed 16-bit samples.
Sample numbers count within a stream, a run of the microphone. Samples that no image carries are silence; two
images may carry the same samples.
"""

import struct
from collections.abc import Iterable
from typing import NamedTuple

from capture_app.session.format.journal import frame_of_line
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.reading.decoding import JPEG_BEGIN
from capture_app.session.reading.reader import Session

MAX_PCM_BYTES = 65_000
"""Samples of one segment, in bytes; a segment's length has 16 bits."""
RATES_HZ = range(8_000, 192_001)
_NAME = b"simulshot sound 1\0"
_HEAD = struct.Struct("<IQIBq")
_APP0, _APP9, _APP15 = 0xE0, 0xE9, 0xEF
_MAX_SAMPLE = 2**53


class SoundPart(NamedTuple):
    """Consecutive samples of a microphone, interleaved if there are two channels."""

    stream: int
    first: int
    rate_hz: int
    channels: int
    local_ns: int
    pcm: bytes

    @property
    def samples(self) -> int:
        """Number of samples of each channel."""
        return len(self.pcm) // (2 * self.channels)


def sound_segments(parts: Iterable[SoundPart]) -> bytes:
    """Return the JPEG segments of these parts, each of at most MAX_PCM_BYTES."""
    contents = (_NAME + _HEAD.pack(*part[:5]) + part.pcm for part in parts)
    return b"".join(struct.pack(">BBH", 0xFF, _APP9, 2 + len(content)) + content for content in contents)


def add_segments(jpeg: bytes, segments: bytes) -> bytes:
    """Return the JPEG with segments after its first ones, such as EXIF; another file unchanged."""
    if not segments or not jpeg.startswith(JPEG_BEGIN):
        return jpeg
    at = _end_of_head(jpeg)
    return jpeg[:at] + segments + jpeg[at:]


def _end_of_head(jpeg: bytes) -> int:
    at = len(JPEG_BEGIN)
    while jpeg[at : at + 1] == b"\xff" and _APP0 <= int.from_bytes(jpeg[at + 1 : at + 2]) <= _APP15:
        at += 2 + max(2, int.from_bytes(jpeg[at + 2 : at + 4]))
    return at


def sounds_of(jpeg: bytes) -> list[SoundPart]:
    """Return the sound in an image's bytes, which are untrusted; nothing of damaged segments."""
    sounds = []
    at, end = len(JPEG_BEGIN), _end_of_head(jpeg)
    while at < end:
        content = jpeg[at + 4 : at + 2 + int.from_bytes(jpeg[at + 2 : at + 4])]
        pcm = content[len(_NAME) + _HEAD.size :]
        if jpeg[at + 1] == _APP9 and content.startswith(_NAME) and pcm:
            part = SoundPart._make((*_HEAD.unpack_from(content, len(_NAME)), pcm))
            if part.rate_hz in RATES_HZ and part.channels in (1, 2) and part.first < _MAX_SAMPLE:
                sounds.append(part._replace(pcm=pcm[: part.samples * 2 * part.channels]))
        at += 2 + max(2, int.from_bytes(jpeg[at + 2 : at + 4]))
    return sounds


def read_sounds(session: Session, camera: str) -> list[tuple[ImageRecord, SoundPart]]:
    """Return the sound in a camera's images, each part with its image. Raises OSError, BadInputError."""
    stored = session.stored_manifest
    images = [image for image in stored.images if image.camera == camera]
    images += [
        frame_of_line(video, line)
        for video in stored.videos
        if video.camera == camera
        for line in session.video_frames(video)
    ]
    return [(image, part) for image in images for part in sounds_of(session.image_bytes(image))]

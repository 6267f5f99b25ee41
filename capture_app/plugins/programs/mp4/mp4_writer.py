"""MP4: a video of each camera, with frames at the leader's times to a microsecond."""

from pathlib import Path
from typing import Annotated

from capture_app.common.text import count
from capture_app.plugins.programs.mp4.mp4_sound import add_own_sound, add_sound, find_recording
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import VIDEOS, Exporter, Option
from capture_app.session.exporting.videos import (
    at_own_times,
    copy_camera,
    write_camera,
    write_video,
)
from capture_app.session.format.manifest import FrameRecord

SEQUENCE = "sequence.mp4"
Sound = Annotated[Path | None, Option("imported recordings, <camera>.*, whose sound to keep", "DIR")]
Wav = Annotated[bool, Option("write the sound of cameras with a microphone also as WAV")]


COPY, H264 = "copy", "h264"
Codec = Annotated[
    str | None,
    Option("copy the JPEGs of recordings (the default), or encode them for browsers", choices=(COPY, H264)),
]


def write(
    burst: ExportedBurst, folder: Path, *, codec: Codec = None, sound: Sound = None, wav: Wav = False
) -> None:
    """Write <camera>.mp4 for each camera; all start at the burst's earliest image.

    A recording of JPEGs is copied, unless the `codec` is H264 or `lossless` is requested.
    Each has the sound of its camera's microphone, or of the recording in `sound` that is named as the camera,
    on the rig's time.
    Of a staggered session also write all cameras' images in the order of their times, as one video.
    """
    copied: list[str] = []
    for camera in burst.cameras:
        shown = at_own_times(burst, camera)
        if (
            codec != H264
            and not burst.lossless
            and all(isinstance(image, FrameRecord) for _, _, image in shown)
        ):
            copy_camera(burst, folder / f"{camera}.mp4", shown, camera)
            copied.append(f"{camera}.mp4")
        else:
            write_camera(burst, folder / f"{camera}.mp4", shown, camera)
        recording = find_recording(sound, camera) if sound else None
        if recording:
            add_sound(burst, camera, recording, folder / f"{camera}.mp4")
        else:
            add_own_sound(burst, camera, folder / f"{camera}.mp4", wav=wav)
        if sound and not recording:
            burst.warn(f"{camera}: {sound} has no recording of this name, so its video has no sound")
    if copied:
        burst.notes.append(
            f"{', '.join(copied)}: the cameras' own JPEGs, unchanged, which VLC, mpv and FFmpeg play;"
            f" for browsers: --codec {H264}"
        )
    if burst.session.manifest.is_staggered:
        _write_sequence(burst, folder)


def _write_sequence(burst: ExportedBurst, folder: Path) -> None:
    """Write the merged video if the cameras' images have one size and times of their own; else add a note."""
    sizes = {burst.size(camera) for camera in burst.cameras}
    delays_ns = {burst.session.camera(camera).delay_ns for camera in burst.cameras}
    if SEQUENCE in (f"{camera}.mp4" for camera in burst.cameras) or len(sizes) > 1:
        burst.notes.append(f"no {SEQUENCE}: the cameras' images are of several sizes, or one has that name")
    elif len(delays_ns) < len(burst.cameras):
        burst.notes.append(f"no {SEQUENCE}: cameras with equal delays take their images together")
    else:
        images = sorted(
            (image for camera in burst.cameras for image in burst.images_of(camera)),
            key=lambda image: image.leader_ns,
        )
        frames = ((image.leader_ns - burst.origin_ns, burst.load(image)[1]) for image in images)
        step_ns = burst.period_ns // len(delays_ns)
        write_video(folder / SEQUENCE, frames, sizes.pop(), step_ns, lossless=burst.lossless)
        burst.notes.append(f"{SEQUENCE} has {count(len(images), 'frame')} of all cameras in order of time")


EXPORTER = Exporter(
    write=write,
    help="a video of each camera with its exact timestamps",
    program="MP4",
    packages=VIDEOS,
)

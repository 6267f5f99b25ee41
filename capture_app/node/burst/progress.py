"""How far a burst is, for whoever looks."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from capture_app.errors import DiskError, DiskFullError
from capture_app.node.burst.camera_progress import CameraProgress
from capture_app.node.burst.image_commits import ImageCommits
from capture_app.node.burst.instant_choice import InstantChoice
from capture_app.node.wire.status import BurstStatus
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_picks import Burst
from capture_app.text import count

SAID_AFTER_S = 1.0
"""A wait for the disk that takes longer is told."""


def waiting_text(commits: ImageCommits, undecided: Sequence[str]) -> str:
    """What a burst waits for: the disk, or cameras that have not told what they have; empty for neither."""
    images, seconds = commits.waiting()
    if seconds >= SAID_AFTER_S:
        return f"waiting for the disk: {count(images, 'image')}, {seconds:.0f} s"
    return f"waiting to hear from {', '.join(undecided)}" if undecided else ""


def disk_reason(error: DiskError) -> str:
    """Why images are missing when the leader's disk failed."""
    return "the leader's disk is full" if isinstance(error, DiskFullError) else f"at the leader: {error.what}"


def burst_status(
    burst: Burst,
    writer: SessionWriter,
    cameras: Mapping[str, CameraProgress],
    choice: InstantChoice,
    *,
    message: str,
    done: bool,
    session: Path | None,
    resumed: bool,
) -> BurstStatus:
    """How far a burst is; one of an earlier run has no number in this one."""
    # Nobody knows how long a recording will be: of one under way as much is expected as any camera has sent.
    so_far = max((camera.instants.end for camera in cameras.values()), default=0)
    instants = so_far if burst.video and not done else burst.frames
    transfer = tuple(camera.transfer(instants) for _, camera in sorted(cameras.items()))
    received, expected = sum(t.received for t in transfer), sum(t.expected for t in transfer)
    if resumed:
        message = f"{writer.name} of an earlier run: {received} of {expected} images" + (
            f"; {message}" if message else "" if done else ", waiting for what its nodes still hold"
        )
    return BurstStatus(
        burst=0 if resumed else burst.number,
        name=writer.name,
        cameras=len(cameras),
        instants=instants,
        received=received,
        expected=expected,
        done=done,
        session=None if session is None else str(session),
        message=message,
        transfer=transfer,
        recording=burst.video,
        skipped=choice.skipped({name: camera.report for name, camera in cameras.items()}),
    )


def mean_image_bytes(writer: SessionWriter, cameras: Mapping[str, CameraProgress]) -> dict[str, int]:
    """The mean size in bytes of each camera's images, of those that have any."""
    means = {video.camera: video.bytes // video.frames for video in writer.videos.records() if video.frames}
    for name, camera in cameras.items():
        instants = () if name in means else camera.instants
        images = [writer.image(name, instant) for instant in instants]
        sizes = [image.bytes for image in images if image is not None]
        if sizes:
            means[name] = sum(sizes) // len(sizes)
    return means

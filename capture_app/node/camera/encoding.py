"""Turns a picked frame into an image file, in a thread that lets all others go first."""

import contextlib
import hashlib
import os
import threading

from capture_app.cameras.base import CapturedFrame
from capture_app.node.wire.messages import CameraReport, ImageUpload
from capture_app.session.format.manifest import ImageRecord, image_path
from capture_app.sync.rig.frame_selection import SelectedFrame

LOW_PRIORITY = 10
"""Niceness of the thread that encodes pictures: the clock exchange comes first."""


class EncodingError(Exception):
    """A frame that could not be turned into an image file."""


def encode_frame(
    report: CameraReport, picked: SelectedFrame[CapturedFrame], *, with_truth: bool = True
) -> tuple[ImageUpload, bytes]:
    """Return an image's header and its bytes, ground truth behind them. Raises EncodingError."""
    frame = picked.frame
    try:
        image = frame.picture.encode()
        truth = b"" if frame.truth is None or not with_truth else frame.truth.encode()
    except Exception as error:
        # Drivers and encoders raise what they like; one bad frame must not end the node.
        raise EncodingError(f"the frame could not be encoded: {error}") from error
    camera, name = report.plan.camera, report.plan.camera.name
    record = ImageRecord(
        camera=name,
        instant=picked.instant,
        path=image_path(name, picked.instant),
        leader_ns=picked.leader_ns,
        bytes=len(image),
        sha256=hashlib.sha256(image).hexdigest(),
        local_ns=picked.local_ns,
        residual_ns=picked.residual_ns,
        uncertainty_ns=picked.uncertainty_ns,
        hard_bound_ns=picked.hard_bound_ns,
        exposure_start_ns=camera.facts.exposure_start_ns(picked.stamp_leader_ns, frame.exposure_ns),
        exposure_ns=frame.exposure_ns,
        gain=frame.gain,
        white_balance=frame.white_balance,
        sequence=frame.sequence,
        outlier_ns=picked.outlier_ns,
        alignment_offset_ns=picked.alignment_offset_ns,
        late=camera.is_late(picked.residual_ns),
    )
    upload = ImageUpload(
        leader=report.leader,
        burst=report.burst,
        record=record,
        truth_bytes=len(truth),
        true_ns=None if frame.truth is None else frame.truth.true_ns,
        truth_sha256=hashlib.sha256(truth).hexdigest() if truth else None,
    )
    return upload, image + truth


def lower_priority() -> None:
    """Let all other threads of this process go before the present one."""
    # Linux knows a niceness for each thread; where there is none, all threads stay equal.
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOW_PRIORITY)

"""Encodes a node's picked frames one after the other, into its spool where there is room."""

import asyncio
import contextlib
import hashlib
import os
import threading
from concurrent.futures import ThreadPoolExecutor

from capture_app.cameras.base import CapturedFrame
from capture_app.errors import SimulshotError
from capture_app.node.camera.burst_upload import BurstUpload
from capture_app.node.camera.spool import Spool
from capture_app.node.news import Log
from capture_app.node.wire.messages import CameraReport, ImageUpload
from capture_app.session.format.manifest import ImageRecord, image_path
from capture_app.sync.rig.frame_picks import Pick

LOW_PRIORITY = 10
"""Niceness of the thread that encodes pictures: the clock exchange comes first."""


class EncodingError(Exception):
    """A frame that could not be turned into an image file."""


def encode_frame(
    report: CameraReport, picked: Pick[CapturedFrame], *, with_truth: bool = True
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


class FrameEncoder:
    """One thread that turns frames into image files; without a spool they stay in memory."""

    def __init__(self, log: Log, spool: Spool | None) -> None:
        self._log = log
        self._spool = spool
        self._thread = ThreadPoolExecutor(1, "encode", initializer=lower_priority)

    async def encode_next(self, burst: BurstUpload) -> None:
        """Encode the first frame of a burst that has one, and move it to its images."""
        loop = asyncio.get_running_loop()
        picked = burst.frames[0]
        try:
            image = await loop.run_in_executor(self._thread, self._encode, burst, picked)
        except EncodingError as error:
            burst.report_lost([picked.instant], str(error))
            self._log.say(f"burst {burst.report.burst}: instant {picked.instant} is lost: {error}")
            image = None
        # While it was encoded, the leader may have refused the burst.
        if burst.frames and burst.frames[0] is picked:
            burst.frames.popleft()
            if burst.stream is not None:
                burst.stream.note_encoded(picked)
            if image is not None:
                burst.images.append(image)

    def close(self) -> None:
        """Encode nothing more."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _encode(self, burst: BurstUpload, picked: Pick[CapturedFrame]) -> ImageUpload:
        with_truth = burst.stream is None or not burst.stream.video
        image, data = encode_frame(burst.report, picked, with_truth=with_truth)
        # It can be sent from here at once, while the spool's disk takes its time.
        burst.in_memory[picked.instant] = data
        if self._spool is None or not burst.spooling:
            return image
        try:
            if burst.spooled is None:
                burst.spooled = self._spool.create_burst(burst.report_to_keep())
            burst.spooled.add_image(image, data)
        except SimulshotError as error:
            note_useless_spool(burst, error, self._log)
        else:
            burst.unsynced[picked.instant] = image
        return image


def note_useless_spool(burst: BurstUpload, error: SimulshotError, log: Log) -> None:
    """Keep a burst in memory from now on, as the spool cannot take it; the next one tries again."""
    burst.spooling = False
    log.say(f"burst {burst.report.burst} is kept in memory until the leader has it: {error}")


def lower_priority() -> None:
    """Let all other threads of this process go before the present one."""
    # Linux knows a niceness for each thread; where there is none, all threads stay equal.
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOW_PRIORITY)

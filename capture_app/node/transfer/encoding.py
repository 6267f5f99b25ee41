"""Develops a node's picked frames one after the other, into its spool where there is room."""

import asyncio
import contextlib
import hashlib
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import msgspec

from capture_app.cameras.base import CapturedFrame
from capture_app.errors import SimulshotError
from capture_app.node.transfer.spool import Spool
from capture_app.node.transfer.work import BurstWork, Developed
from capture_app.node.wire.messages import CameraReport, ImageUpload
from capture_app.session.format.manifest import ImageRecord, MissingImage, image_path
from capture_app.sync.rig.frame_picks import Pick


class DevelopError(Exception):
    """A frame that could not be turned into an image file."""


def develop(report: CameraReport, pick: Pick[CapturedFrame]) -> tuple[ImageUpload, bytes]:
    """Return an image's header and its bytes, ground truth behind them. Raises DevelopError."""
    frame = pick.frame
    try:
        image = frame.payload.encode()
        truth = b"" if frame.truth is None else frame.truth.encode()
    except Exception as error:
        # Drivers and encoders raise what they like; one bad frame must not end the node.
        raise DevelopError(f"the frame could not be developed: {error}") from error
    camera, name = report.camera, report.camera.name
    tolerance_ns = camera.phase.tolerance_ns if camera.phase else None
    record = ImageRecord(
        camera=name,
        instant=pick.instant,
        path=image_path(name, pick.instant),
        leader_ns=pick.leader_ns,
        bytes=len(image),
        sha256=hashlib.sha256(image).hexdigest(),
        local_ns=pick.local_ns,
        residual_ns=pick.residual_ns,
        uncertainty_ns=pick.uncertainty_ns,
        hard_bound_ns=pick.hard_bound_ns,
        exposure_start_ns=camera.facts.exposure_start_ns(pick.leader_ns, frame.exposure_ns),
        exposure_ns=frame.exposure_ns,
        gain=frame.gain,
        white_balance=frame.white_balance,
        sequence=frame.sequence,
        outlier_ns=pick.outlier_ns,
        late=tolerance_ns is not None and abs(pick.residual_ns) > tolerance_ns,
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


def without(report: CameraReport, *lost: MissingImage) -> CameraReport:
    """The report of a camera that turns out to lack some of the images that it announced."""
    gone = {image.instant for image in lost}
    instants = tuple(instant for instant in report.instants if instant not in gone)
    return msgspec.structs.replace(report, instants=instants, missing=(*report.missing, *lost))


LOW_PRIORITY = 10
"""Niceness of the thread that develops pictures: the clock exchange comes first."""


class Developer:
    """One thread that turns frames into image files; without a spool they stay in memory."""

    def __init__(self, talk: Callable[[str], None], spool: Spool | None) -> None:
        self.image_bytes = 0
        """Size of the newest image."""
        self._talk = talk
        self._spool = spool
        self._thread = ThreadPoolExecutor(1, "develop", initializer=_lower_priority)

    async def develop_next(self, work: BurstWork) -> None:
        """Develop the first frame of a burst that has one, and move it to its images."""
        loop = asyncio.get_running_loop()
        pick = work.picks[0]
        try:
            developed = await loop.run_in_executor(self._thread, self._develop, work, pick)
        except DevelopError as error:
            lost = MissingImage(camera=work.report.camera.name, instant=pick.instant, reason=str(error))
            work.report = without(work.report, lost)
            self._talk(f"burst {work.report.burst}: instant {pick.instant} is lost: {error}")
            developed = None
        # While it was developed, the leader may have refused the burst.
        if work.picks and work.picks[0] is pick:
            work.picks.popleft()
            if developed is not None:
                work.images.append(developed)

    def close(self) -> None:
        """Develop nothing more."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _develop(self, work: BurstWork, pick: Pick[CapturedFrame]) -> Developed:
        upload, data = develop(work.report, pick)
        self.image_bytes = len(data)
        if self._spool is None or not work.spooling:
            return Developed(upload, data)
        try:
            if work.spooled is None:
                work.spooled = self._spool.begin(work.report)
            work.spooled.keep(upload, data)
        except SimulshotError as error:
            work.spooling = False
            self._talk(f"burst {work.report.burst} is kept in memory until the leader has it: {error}")
            return Developed(upload, data)
        return Developed(upload, None)


def _lower_priority() -> None:
    # Linux knows a niceness for each thread; where there is none, all threads stay equal.
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOW_PRIORITY)

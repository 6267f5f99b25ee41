"""From a picked frame to the bytes of an image file and all that is known of it."""

import hashlib

import msgspec

from capture_app.cameras.base import CapturedFrame
from capture_app.node.messages import CameraReport, ImageUpload
from capture_app.session.manifest import ImageRecord, MissingImage, image_path
from capture_app.session.rows import exposure_start_ns
from capture_app.sync.trigger import Pick


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
        exposure_start_ns=exposure_start_ns(camera, pick.leader_ns, frame.exposure_ns),
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

"""The clouds of a sequence as one recording that Rerun plays, with the cameras and their pictures."""

from collections.abc import Sequence
from pathlib import Path

from capture_app.optional_packages import load_optional
from capture_app.session.exporters.common.point_cloud import read_ply
from capture_app.session.exporters.rrd import log_cameras, set_times
from capture_app.session.format.calibration import Calibration
from reconstruction.multiview.result import SequenceInstant
from reconstruction.session.dataset import Dataset

RECORDING = "sequence.rrd"
_JPEG = b"\xff\xd8"


def write_recording(
    file: Path, out: Path, dataset: Dataset, calibration: Calibration, instants: Sequence[SequenceInstant]
) -> None:
    """Write `cloud` (those in `out`) and `rig/<camera>` on the timelines `leader` and `instant`.

    One instant is in memory at a time. Raises NotAvailableError without rerun-sdk.
    """
    rerun = load_optional("rerun", "rerun", "the .rrd format")
    stream = rerun.RecordingStream("simulshot", recording_id=dataset.name, send_properties=False)
    stream.save(file)
    log_cameras(rerun, stream, calibration.cameras)
    for one in instants:
        set_times(stream, one.leader_ns, one.instant)
        cloud = read_ply(out / one.cloud)
        stream.log("cloud", rerun.Points3D(cloud.points, colors=cloud.colours))
        for camera in dataset.cameras:
            if camera in calibration.cameras and dataset.has_image(camera, one.instant):
                picture = dataset.image_bytes(camera, one.instant)
                kind = "image/jpeg" if picture.startswith(_JPEG) else "image/png"
                stream.log(f"rig/{camera}", rerun.EncodedImage(contents=picture, media_type=kind))
    stream.flush()
    stream.disconnect()

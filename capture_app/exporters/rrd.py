"""Rerun's .rrd: images and cameras on a timeline of the leader's clock. Needs rerun-sdk."""

from pathlib import Path

from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import Exporter
from capture_app.session.exporting.files import jpeg_or_png
from capture_app.session.exporting.rerun_stream import log_cameras, set_times


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write <session>.rrd: entities rig/<camera>, timelines `leader` (exact to the ns) and `instant`.

    The format cannot hold lens distortion.
    """
    import rerun

    file = f"{burst.name}.rrd"
    stream = rerun.RecordingStream("simulshot", recording_id=burst.name, send_properties=False)
    stream.save(folder / file)
    if burst.calibration is not None:
        log_cameras(rerun, stream, burst.calibration.cameras)
    images = [image for camera in burst.cameras for image in burst.images_of(camera)]
    for image in sorted(images, key=lambda image: (image.leader_ns, image.camera)):
        data, kind = jpeg_or_png(burst, image)
        set_times(stream, image.leader_ns, image.instant)
        stream.log(f"rig/{image.camera}", rerun.EncodedImage(contents=data, media_type=f"image/{kind}"))
        burst.put(image, file, len(burst.frames))
    stream.flush()
    stream.disconnect()


EXPORTER = Exporter(
    write=write,
    help="one .rrd for Rerun",
    program="Rerun",
    calibration="optional",
    packages={"rerun": "rerun"},
)

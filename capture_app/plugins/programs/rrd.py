"""Rerun's .rrd: images and cameras on a timeline of the leader's clock. Needs rerun-sdk."""

from pathlib import Path

from capture_app.session.exporting.exported_burst import ExportedBurst, jpeg_or_png
from capture_app.session.exporting.exporter import Exporter
from capture_app.session.exporting.rerun_stream import rerun_recording, set_times


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write <session>.rrd: entities rig/<camera>, timelines `leader` (exact to the ns) and `instant`.

    The format cannot hold lens distortion.
    """
    file = f"{burst.name}.rrd"
    cameras = burst.calibration.cameras if burst.calibration is not None else {}
    images = [image for camera in burst.cameras for image in burst.images_of(camera)]
    with rerun_recording(burst.name, folder / file, cameras) as (rerun, stream):
        for image in sorted(images, key=lambda image: (image.leader_ns, image.camera)):
            data, kind = jpeg_or_png(burst, image)
            set_times(stream, image.leader_ns, image.instant)
            stream.log(f"rig/{image.camera}", rerun.EncodedImage(contents=data, media_type=f"image/{kind}"))
            burst.put(image, file, len(burst.frames))


EXPORTER = Exporter(
    write=write,
    help="one .rrd for Rerun",
    program="Rerun",
    calibration="optional",
    packages={"rerun": "rerun"},
)

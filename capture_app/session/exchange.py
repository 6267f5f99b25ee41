"""What exports keep for the way back, and the messages of an MCAP.

The record in an export, `simulshot.json`, is all that the other program's format has no place for. With
`frames.csv`, which says where each image is in the export, an export becomes the session again that it was
made of. Messages are Foxglove's as protobuf, the one encoding of them that Rerun reads, or those of ROS 2.
"""

from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from capture_app.common.optional_packages import load_optional
from capture_app.session.files.strangers import read_struct
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import ImageRecord, Manifest, check_references, image_path

FORMATS = {
    "colmap": "images and rig_config.json; a model where calibrated",
    "nerfstudio": "transforms.json with the time of every image",
    "n3dv": "Neural 3D Video, 4DGaussians: camNN.mp4, poses, points",
    "easyvolcap": "EasyVolcap: images, intri.yml and extri.yml",
    "easymocap": "EasyMocap: videos, intri.yml and extri.yml",
    "freemocap": "synchronized_videos and the camera calibration",
    "caliscope": "recordings, timestamps.csv and camera_array.toml",
    "pose2sim": "a trial: videos and calibration/Calib.toml",
    "mcap": "one .mcap for Foxglove and Rerun",
    "mp4": "a video of each camera with its exact timestamps",
    "rrd": "one .rrd for Rerun",
}
"""Names as typed after --to; each is the name of a module of `exporters` with a function `write`."""

ROS_BAGS = "ROS bags"
"""What the package rosbags is needed for, in words."""
RECORD = "simulshot.json"
FRAMES = "frames.csv"
"""In every export: where each image is in the export, with its time in ns of the leader's clock."""


class ExportRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The format of an export, and the session's manifest and calibration as they were.

    Frames of videos are images in it. Cameras whose pictures were redrawn have the new ones' calibration.
    """

    format: str
    manifest: Manifest
    calibration: Calibration | None = None
    schema_version: int = 1


def with_images_listed(manifest: Manifest) -> Manifest:
    """The manifest of a session in which the frames of its videos are images."""
    fields = [name for name in ImageRecord.__struct_fields__ if name != "path"]
    images = tuple(
        one
        if type(one) is ImageRecord
        else ImageRecord(
            path=image_path(one.camera, one.instant), **{name: getattr(one, name) for name in fields}
        )
        for one in manifest.images
    )
    return msgspec.structs.replace(manifest, images=images, videos=())


def read_record(folder: Path) -> ExportRecord:
    """Read the record of an export. Raises BadInputError where it is broken or contradicts itself."""
    record = read_struct(folder / RECORD, ExportRecord, 1)
    check_references(folder / RECORD, record.manifest)
    return record


def foxglove_message(name: str) -> Any:
    """The class of a message of Foxglove's, such as CompressedImage. Raises NotAvailableError."""
    return getattr(load_optional(f"foxglove_schemas_protobuf.{name}_pb2", "export", "MCAP"), name)


@cache
def ros_messages() -> Any:
    """The messages of ROS 2, as of Humble. Raises NotAvailableError without rosbags."""
    typesys = load_optional("rosbags.typesys", "ros", ROS_BAGS)
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)

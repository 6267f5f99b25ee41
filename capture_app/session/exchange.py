"""What exports keep for the way back, and the messages of an MCAP.

The record in an export, `simulshot.json`, is all that the other program's format has no place for. With
`frames.csv`, which says where each image is in the export, an export becomes the session again that it was
made of. The messages are Foxglove's as protobuf, as far as a burst needs them: names and numbers of fields
are those of the published schemas (docs.foxglove.dev, foxglove-sdk's proto files); Rerun reads them in this
encoding only.
"""

from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from capture_app.optional_packages import load_optional
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.checks import check_references, encode_checked, indented, read_struct
from capture_app.session.format.manifest import ImageRecord, Manifest, image_path

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

    Cameras whose pictures were redrawn have the calibration of the new ones.
    """

    format: str
    manifest: Manifest
    calibration: Calibration | None = None
    schema_version: int = 1


def write_record(folder: Path, record: ExportRecord) -> None:
    """Write the record into an export's folder; frames of videos are images in it."""
    whole = msgspec.structs.replace(record, manifest=with_images_listed(record.manifest))
    (folder / RECORD).write_bytes(indented(encode_checked(whole, ExportRecord)))


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


_DOUBLE, _STRING, _BYTES, _FIXED32 = 1, 9, 12, 7  # google.protobuf.FieldDescriptorProto.Type
_TIME = ".google.protobuf.Timestamp"
_REPEATED = ("D", "K", "R", "P")

_MESSAGES: dict[str, dict[str, int | str]] = {
    "Vector3": {"x": _DOUBLE, "y": _DOUBLE, "z": _DOUBLE},
    "Quaternion": {"x": _DOUBLE, "y": _DOUBLE, "z": _DOUBLE, "w": _DOUBLE},
    "CompressedImage": {"timestamp": _TIME, "data": _BYTES, "format": _STRING, "frame_id": _STRING},
    "CameraCalibration": {
        "timestamp": _TIME,
        "width": _FIXED32,
        "height": _FIXED32,
        "distortion_model": _STRING,
        **dict.fromkeys(_REPEATED, _DOUBLE),
        "frame_id": _STRING,
    },
    "FrameTransform": {
        "timestamp": _TIME,
        "parent_frame_id": _STRING,
        "child_frame_id": _STRING,
        "translation": ".foxglove.Vector3",
        "rotation": ".foxglove.Quaternion",
    },
}
"""By message, its fields in the order of their numbers, from 1: a scalar's type, or a message's full name."""
_USES = {"FrameTransform": ("Vector3", "Quaternion")}


def descriptor_set(name: str) -> bytes:
    """The schema of a message, as MCAP wants it: a FileDescriptorSet with all that the message uses."""
    files = load_optional("google.protobuf.descriptor_pb2", "export", "MCAP").FileDescriptorSet()
    timestamp = load_optional("google.protobuf.timestamp_pb2", "export", "MCAP")
    timestamp.DESCRIPTOR.CopyToProto(files.file.add())
    for used in (*_USES.get(name, ()), name):
        files.file.add().CopyFrom(_file(used))
    return bytes(files.SerializeToString(deterministic=True))


@cache
def message_class(name: str) -> Any:
    """The class of a message, such as CompressedImage."""
    pool = load_optional("google.protobuf.descriptor_pool", "export", "MCAP").DescriptorPool()
    files = load_optional("google.protobuf.descriptor_pb2", "export", "MCAP").FileDescriptorSet
    for file in files.FromString(descriptor_set(name)).file:
        pool.Add(file)
    factory = load_optional("google.protobuf.message_factory", "export", "MCAP")
    return factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))


def _file(name: str) -> Any:
    file = load_optional("google.protobuf.descriptor_pb2", "export", "MCAP").FileDescriptorProto(
        name=f"foxglove/{name}.proto", package="foxglove", syntax="proto3"
    )
    if _TIME in _MESSAGES[name].values():
        file.dependency.append("google/protobuf/timestamp.proto")
    file.dependency.extend(f"foxglove/{used}.proto" for used in _USES.get(name, ()))
    message = file.message_type.add(name=name)
    for number, (field_name, kind) in enumerate(_MESSAGES[name].items(), 1):
        label = 3 if field_name in _REPEATED else 1
        field = message.field.add(name=field_name, number=number, label=label)
        if isinstance(kind, str):
            field.type, field.type_name = 11, kind
        else:
            field.type = kind
    return file


def ros_messages() -> Any:
    """The messages of ROS 2, as of Humble. Raises NotAvailableError without rosbags."""
    typesys = load_optional("rosbags.typesys", "ros", ROS_BAGS)
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)

"""Foxglove's message schemas as protobuf, as far as a burst needs them.

Field names and numbers are those of the published schemas (docs.foxglove.dev, foxglove-sdk's proto files);
Rerun reads them in this encoding only.
"""

from functools import cache
from typing import Any

from capture_app.optional_packages import load_optional

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

"""Foxglove's message schemas as protobuf, as far as a burst needs them.

Field names and numbers are those of the published schemas (docs.foxglove.dev, foxglove-sdk's proto files);
Rerun reads them in this encoding only.
"""

from functools import cache
from typing import Any

from capture_app.session.exporters.common.optional_packages import load_package

_DOUBLE, _STRING, _BYTES, _FIXED32 = 1, 9, 12, 7  # google.protobuf.FieldDescriptorProto.Type
_TIME = ".google.protobuf.Timestamp"

Field = tuple[int, str, int | str, bool]
"""Number, name, type (a scalar's, or a message's full name), repeated."""

_MESSAGES: dict[str, tuple[Field, ...]] = {
    "Vector3": ((1, "x", _DOUBLE, False), (2, "y", _DOUBLE, False), (3, "z", _DOUBLE, False)),
    "Quaternion": (
        (1, "x", _DOUBLE, False),
        (2, "y", _DOUBLE, False),
        (3, "z", _DOUBLE, False),
        (4, "w", _DOUBLE, False),
    ),
    "CompressedImage": (
        (1, "timestamp", _TIME, False),
        (2, "data", _BYTES, False),
        (3, "format", _STRING, False),
        (4, "frame_id", _STRING, False),
    ),
    "CameraCalibration": (
        (1, "timestamp", _TIME, False),
        (2, "width", _FIXED32, False),
        (3, "height", _FIXED32, False),
        (4, "distortion_model", _STRING, False),
        (5, "D", _DOUBLE, True),
        (6, "K", _DOUBLE, True),
        (7, "R", _DOUBLE, True),
        (8, "P", _DOUBLE, True),
        (9, "frame_id", _STRING, False),
    ),
    "FrameTransform": (
        (1, "timestamp", _TIME, False),
        (2, "parent_frame_id", _STRING, False),
        (3, "child_frame_id", _STRING, False),
        (4, "translation", ".foxglove.Vector3", False),
        (5, "rotation", ".foxglove.Quaternion", False),
    ),
}
_USES = {"FrameTransform": ("Vector3", "Quaternion")}


def descriptor_set(name: str) -> bytes:
    """The schema of a message, as MCAP wants it: a FileDescriptorSet with all that the message uses."""
    files = load_package("google.protobuf.descriptor_pb2", "MCAP").FileDescriptorSet()
    timestamp = load_package("google.protobuf.timestamp_pb2", "MCAP")
    timestamp.DESCRIPTOR.CopyToProto(files.file.add())
    for used in (*_USES.get(name, ()), name):
        files.file.add().CopyFrom(_file(used))
    return bytes(files.SerializeToString(deterministic=True))


@cache
def message_class(name: str) -> Any:
    """The class of a message, such as CompressedImage."""
    pool = load_package("google.protobuf.descriptor_pool", "MCAP").DescriptorPool()
    files = load_package("google.protobuf.descriptor_pb2", "MCAP").FileDescriptorSet
    for file in files.FromString(descriptor_set(name)).file:
        pool.Add(file)
    factory = load_package("google.protobuf.message_factory", "MCAP")
    return factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))


def _file(name: str) -> Any:
    file = load_package("google.protobuf.descriptor_pb2", "MCAP").FileDescriptorProto(
        name=f"foxglove/{name}.proto", package="foxglove", syntax="proto3"
    )
    if any(kind == _TIME for _, _, kind, _ in _MESSAGES[name]):
        file.dependency.append("google/protobuf/timestamp.proto")
    file.dependency.extend(f"foxglove/{used}.proto" for used in _USES.get(name, ()))
    message = file.message_type.add(name=name)
    for number, field_name, kind, repeated in _MESSAGES[name]:
        field = message.field.add(name=field_name, number=number, label=3 if repeated else 1)
        if isinstance(kind, str):
            field.type, field.type_name = 11, kind
        else:
            field.type = kind
    return file

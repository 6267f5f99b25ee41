"""MCAP: compressed images, calibrations and transforms as Foxglove messages, or as a ROS 2 bag.

Foxglove's are protobuf, with one chunk for each set of frames. The bag, written by `rosbags` as CDR, has the
topics of ROS's image_transport: <camera>/image_raw/compressed beside <camera>/camera_info, and the cameras'
poses in /tf_static; frames look along z, as REP 103 defines for optical frames.
"""

import re
from collections.abc import Iterable, Iterator
from itertools import chain, count, groupby
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from capture_app.plugins.programs.mcap.bags import foxglove_message, ros_messages
from capture_app.session.exporting.exported_burst import ExportedBurst, jpeg_or_png
from capture_app.session.exporting.exporter import Exporter, Option
from capture_app.session.files.untrusted_files import indented
from capture_app.session.format.calibration import METRES, Calibration, CameraCalibration
from capture_app.session.format.export_record import with_images_listed
from capture_app.session.format.lens import (
    Array,
    centre_of,
    distortion_of,
    matrix_of,
    quaternion,
    rotation_of,
)
from capture_app.session.format.manifest import CALIBRATION, MANIFEST, ImageRecord

_CHUNK = 1 << 62  # a chunk ends with a set of frames, never because of its size
_IMAGE, _INFO, _TF = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
_GEOMETRY = "geometry_msgs/msg"


def write(
    burst: ExportedBurst,
    folder: Path,
    *,
    ros: Annotated[bool, Option("a bag of ROS 2, for ros2 bag play", packages={"rosbags": "ros"})] = False,
) -> None:
    """Write <session>.mcap with the topics /<camera>/image, and /<camera>/calibration and /tf if calibrated.

    log_time and publish_time are an image's leader_ns. JPEG and PNG images keep the session's own bytes,
    others are converted to PNG. The manifest and the calibration are attached. With the option `ros`, write
    the folder <session>/ instead, a bag for `ros2 bag play`.
    """
    (_write_bag if ros else _write_foxglove)(burst, folder, burst.calibration)


def _write_foxglove(burst: ExportedBurst, folder: Path, calibration: Calibration | None) -> None:
    from mcap import writer as mcap
    from mcap_protobuf.schema import register_schema

    file = f"{burst.name}.mcap"
    channels: dict[str, int] = {}
    zero_ns = min(0, burst.origin_ns)  # leader time of log_time 0, which is unsigned
    with (folder / file).open("wb") as stream:
        writer: Any = mcap.Writer(
            stream, chunk_size=_CHUNK, compression=mcap.CompressionType.NONE, enable_data_crcs=True
        )
        writer.start(library="simulshot")
        images = [image for camera in burst.cameras for image in burst.images_of(camera)]
        images.sort(key=lambda image: (image.instant, image.leader_ns))
        for instant, together in groupby(images, key=lambda image: image.instant):
            for image in together:
                at_ns = image.leader_ns - zero_ns
                seconds, nanos = divmod(image.leader_ns, 1_000_000_000)
                for topic, name, fields in _foxglove_messages(burst, image, calibration):
                    kind = foxglove_message(name)
                    if topic not in channels:
                        schema = register_schema(writer, kind)
                        channels[topic] = writer.register_channel(topic, "protobuf", schema)
                    message = kind(timestamp={"seconds": seconds, "nanos": nanos}, **fields)
                    data = message.SerializeToString(deterministic=True)
                    writer.add_message(channels[topic], at_ns, data, at_ns, sequence=instant)
                burst.put(image, file, len(burst.frames))
            writer.flush()
        for name in (MANIFEST, CALIBRATION) if calibration else (MANIFEST,):
            data = (burst.session.folder / name).read_bytes()
            if name == MANIFEST and burst.session.manifest.videos:
                data = indented(msgspec.json.encode(with_images_listed(burst.session.manifest)))
            writer.add_attachment(0, 0, name, "application/json", data)
        writer.add_metadata("simulshot", {"session": burst.name, "log_time_zero_leader_ns": str(zero_ns)})
        writer.finish()


def _foxglove_messages(
    burst: ExportedBurst, image: ImageRecord, calibration: Calibration | None
) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield topic, type and fields of an image's messages: its camera's calibration and pose, then itself."""
    own = {"frame_id": image.camera}
    if calibration is not None:
        camera = calibration.cameras[image.camera]
        lens = {name.upper(): values.tolist() for name, values in _lens(camera).items()}
        own_lens = {"width": camera.width, "height": camera.height, "distortion_model": "plumb_bob", **lens}
        yield f"/{image.camera}/calibration", "CameraCalibration", own | own_lens
        place, rotation = _pose(camera, calibration)
        frames = {"parent_frame_id": "rig", "child_frame_id": image.camera}
        yield "/tf", "FrameTransform", {"translation": place, "rotation": rotation, **frames}
    data, kind = jpeg_or_png(burst, image)
    yield f"/{image.camera}/image", "CompressedImage", {**own, "data": data, "format": kind}


def _write_bag(burst: ExportedBurst, folder: Path, calibration: Calibration | None) -> None:
    """Write the bag <session>/; stamps and arrival times are leader_ns."""
    from rosbags import rosbag2

    origin_ns = min(0, burst.origin_ns)
    connections: dict[str, Any] = {}
    with rosbag2.Writer(folder / burst.name, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        for leader_ns, topic, kind, fields in _bag_messages(burst, origin_ns, calibration):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ros_messages())
            data = ros_messages().serialize_cdr(_ros(kind, **fields), kind)
            writer.write(connections[topic], leader_ns - origin_ns, data)
    if origin_ns:
        burst.notes.append(f"stamps count from {origin_ns} ns of the leader's time: ROS's have no sign")


def _bag_messages(
    burst: ExportedBurst, origin_ns: int, calibration: Calibration | None
) -> Iterator[tuple[int, str, str, dict[str, Any]]]:
    """Yield leader time (ns), topic, type and fields of each message; stamps count from `origin_ns`."""
    topics = ros_topics(burst.cameras)
    images = sorted((i for c in burst.cameras for i in burst.images_of(c)), key=lambda image: image.leader_ns)

    def header(leader_ns: int, frame_id: str) -> Any:
        stamp = _ros("builtin_interfaces/msg/Time", *divmod(leader_ns - origin_ns, 1_000_000_000))
        return _ros("std_msgs/msg/Header", stamp, frame_id)

    if calibration is not None and images:
        first_ns = images[0].leader_ns
        places = [
            _ros(f"{_GEOMETRY}/TransformStamped", header(first_ns, "rig"), name, _place(name, calibration))
            for name in burst.cameras
        ]
        yield first_ns, "/tf_static", _TF, {"transforms": places}
    for number, image in enumerate(images):
        topic, own = topics[image.camera], {"header": header(image.leader_ns, image.camera)}
        if calibration is not None:
            camera = calibration.cameras[image.camera]
            about = {
                "height": camera.height,
                "width": camera.width,
                "distortion_model": "plumb_bob",
                "binning_x": 0,
                "binning_y": 0,
                "roi": _ros("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False),  # the whole image
            }
            yield image.leader_ns, f"{topic}/camera_info", _INFO, {**own, **about, **_lens(camera)}
        data, kind = jpeg_or_png(burst, image)
        compressed = {"format": kind, "data": np.frombuffer(data, np.uint8)}
        yield image.leader_ns, f"{topic}/image_raw/compressed", _IMAGE, {**own, **compressed}
        burst.put(image, f"{burst.name}/{burst.name}.mcap", number)


def _ros(kind: str, *values: Any, **fields: Any) -> Any:
    """Create a message of ROS, or a part of one."""
    return ros_messages().types[kind](*values, **fields)


def _place(camera: str, calibration: Calibration) -> Any:
    """Return ROS's transform from a camera to the rig."""
    at, rotation = _pose(calibration.cameras[camera], calibration)
    quaternion = _ros(f"{_GEOMETRY}/Quaternion", **rotation)
    return _ros(f"{_GEOMETRY}/Transform", _ros(f"{_GEOMETRY}/Vector3", **at), quaternion)


def ros_topics(cameras: Iterable[str]) -> dict[str, str]:
    """Return each camera's topic name, valid in ROS: letters, digits and _, no digit first."""
    preferred = {camera: re.sub(r"^(?=\d)", "cam", re.sub(r"\W", "_", camera)) for camera in cameras}
    topics: dict[str, str] = {}
    # A name that is valid in ROS stays unchanged.
    for camera, own in sorted(preferred.items(), key=lambda pair: pair[0] != pair[1]):
        numbered = chain((own,), (f"{own}_{number}" for number in count(2)))
        topics[camera] = next(topic for name in numbered if (topic := f"/{name}") not in topics.values())
    return topics


def _lens(camera: CameraCalibration) -> dict[str, Array]:
    """Return the numbers of a ROS camera_info; Foxglove has the same names in capital letters."""
    matrix = matrix_of(camera)
    return {
        "d": distortion_of(camera),
        "k": matrix.ravel(),
        "r": np.eye(3).ravel(),
        "p": np.column_stack([matrix, np.zeros(3)]).ravel(),
    }


def _pose(camera: CameraCalibration, calibration: Calibration) -> tuple[dict[str, float], dict[str, float]]:
    """Return a camera's position in the rig, in metres, and its orientation."""
    centre = centre_of(camera) * METRES.get(calibration.unit, 1.0)
    rotation = dict(zip("wxyz", quaternion(rotation_of(camera).T), strict=True))
    return dict(zip("xyz", centre.tolist(), strict=True)), rotation


EXPORTER = Exporter(
    write=write,
    help="one .mcap for Foxglove and Rerun",
    program="MCAP",
    calibration="optional",
    uncalibrated="the session has no calibration: the file has images only",
    unit="m",
    packages=dict.fromkeys(("mcap", "mcap_protobuf", "foxglove_schemas_protobuf"), "export"),
)

"""MCAP: compressed images, calibrations and transforms as Foxglove messages, or as a ROS 2 bag.

Foxglove's are protobuf, with one chunk for each set of frames. The bag, written by `rosbags` as CDR, has the
topics of ROS's image_transport: <camera>/image_raw/compressed beside <camera>/camera_info, and the cameras'
poses in /tf_static; frames look along z, as REP 103 defines for optical frames.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from capture_app.session.exporting.exported_burst import ExportedBurst, jpeg_or_png
from capture_app.session.exporting.exporter import Exporter, ExportOptions, Option
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
from capture_app.session.importing.bags import foxglove_message, ros_messages

_CHUNK = 1 << 62  # a chunk ends with a set of frames, never because of its size
_IMAGE, _INFO, _TF = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Options(ExportOptions):
    ros: Annotated[bool, Option("a bag of ROS 2, for ros2 bag play", packages={"rosbags": "ros"})] = False


def write(burst: ExportedBurst, folder: Path, options: _Options) -> None:
    """Write <session>.mcap with the topics /<camera>/image, and /<camera>/calibration and /tf if calibrated.

    log_time and publish_time are an image's leader_ns. JPEG and PNG images keep the session's own bytes,
    others are converted to PNG. The manifest and the calibration are attached. With the option `ros`, write
    the folder <session>/ instead, a bag for `ros2 bag play`.
    """
    (_write_bag if options.ros else _write_foxglove)(burst, folder, burst.calibration)


def _write_foxglove(burst: ExportedBurst, folder: Path, calibration: Calibration | None) -> None:
    from mcap import writer as mcap

    file = f"{burst.name}.mcap"
    with (folder / file).open("wb") as stream:
        writer: Any = mcap.Writer(
            stream, chunk_size=_CHUNK, compression=mcap.CompressionType.NONE, enable_data_crcs=True
        )
        writer.start(library="simulshot")
        messages = _FoxgloveMessages(writer, min(0, burst.origin_ns))
        for instant in range(len(burst.instants_ns)):
            images = [i for c in burst.cameras for i in burst.images_of(c) if i.instant == instant]
            for image in sorted(images, key=lambda image: image.leader_ns):
                if calibration is not None:
                    messages.add_camera(image, calibration)
                data, kind = jpeg_or_png(burst, image)
                about = {"frame_id": image.camera, "data": data, "format": kind}
                messages.add(f"/{image.camera}/image", "CompressedImage", image, **about)
                burst.put(image, file, len(burst.frames))
            writer.flush()
        for name in (MANIFEST, CALIBRATION) if calibration else (MANIFEST,):
            data = (burst.session.folder / name).read_bytes()
            if name == MANIFEST and burst.session.manifest.videos:
                data = indented(msgspec.json.encode(with_images_listed(burst.session.manifest)))
            writer.add_attachment(0, 0, name, "application/json", data)
        zero_ns = str(messages.zero_ns)
        writer.add_metadata("simulshot", {"session": burst.name, "log_time_zero_leader_ns": zero_ns})
        writer.finish()


class _FoxgloveMessages:
    """Writer of messages to an MCAP; `zero_ns` is the leader time of log_time 0, which is unsigned."""

    def __init__(self, writer: Any, zero_ns: int) -> None:
        self._writer, self.zero_ns = writer, zero_ns
        self._channels: dict[str, int] = {}

    def add_camera(self, image: ImageRecord, calibration: Calibration) -> None:
        camera = calibration.cameras[image.camera]
        about = {"frame_id": image.camera, "width": camera.width, "height": camera.height}
        lens = {name.upper(): values.tolist() for name, values in _lens(camera).items()}
        about |= {"distortion_model": "plumb_bob", **lens}
        self.add(f"/{image.camera}/calibration", "CameraCalibration", image, **about)
        place, rotation = _pose(camera, calibration)
        frames = {"parent_frame_id": "rig", "child_frame_id": image.camera}
        self.add("/tf", "FrameTransform", image, translation=place, rotation=rotation, **frames)

    def add(self, topic: str, name: str, image: ImageRecord, **fields: Any) -> None:
        """Add a message with an image's time and instant."""
        kind = foxglove_message(name)
        if topic not in self._channels:
            from mcap_protobuf.schema import register_schema

            self._channels[topic] = self._writer.register_channel(
                topic, "protobuf", register_schema(self._writer, kind)
            )
        seconds, nanos = divmod(image.leader_ns, 1_000_000_000)
        message = kind(timestamp={"seconds": seconds, "nanos": nanos}, **fields)
        data, at_ns = message.SerializeToString(deterministic=True), image.leader_ns - self.zero_ns
        self._writer.add_message(self._channels[topic], at_ns, data, at_ns, sequence=image.instant)


def _write_bag(burst: ExportedBurst, folder: Path, calibration: Calibration | None) -> None:
    """Write the bag <session>/; stamps and arrival times are leader_ns."""
    from rosbags import rosbag2

    origin_ns, topics = min(0, burst.origin_ns), ros_topics(burst.cameras)
    with rosbag2.Writer(folder / burst.name, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        messages = _RosMessages(writer, origin_ns)
        images = sorted((i for c in burst.cameras for i in burst.images_of(c)), key=lambda one: one.leader_ns)
        if calibration is not None and images:
            places = [messages.place(images[0].leader_ns, name, calibration) for name in burst.cameras]
            messages.add("/tf_static", _TF, images[0].leader_ns, transforms=places)
        for number, image in enumerate(images):
            topic, header = topics[image.camera], messages.header(image.leader_ns, image.camera)
            if calibration is not None:
                camera = calibration.cameras[image.camera]
                about = {"header": header, "height": camera.height, "width": camera.width}
                about |= {"distortion_model": "plumb_bob", "binning_x": 0, "binning_y": 0, **_lens(camera)}
                whole = messages.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
                messages.add(f"{topic}/camera_info", _INFO, image.leader_ns, roi=whole, **about)
            data, kind = jpeg_or_png(burst, image)
            about = {"header": header, "format": kind, "data": np.frombuffer(data, np.uint8)}
            messages.add(f"{topic}/image_raw/compressed", _IMAGE, image.leader_ns, **about)
            burst.put(image, f"{burst.name}/{burst.name}.mcap", number)
    if origin_ns:
        burst.notes.append(f"stamps count from {origin_ns} ns of the leader's time: ROS's have no sign")


class _RosMessages:
    """Writer of messages to a bag; `origin_ns` is the leader time of stamp 0."""

    def __init__(self, writer: Any, origin_ns: int) -> None:
        self._writer, self._store, self._origin_ns = writer, ros_messages(), origin_ns
        self._connections: dict[str, Any] = {}

    def place(self, leader_ns: int, camera: str, calibration: Calibration) -> Any:
        """Return the transform from a camera to the rig."""
        at, rotation = _pose(calibration.cameras[camera], calibration)
        vector, quarter = (f"geometry_msgs/msg/{name}" for name in ("Vector3", "Quaternion"))
        pose = self.make(
            "geometry_msgs/msg/Transform", self.make(vector, **at), self.make(quarter, **rotation)
        )
        return self.make("geometry_msgs/msg/TransformStamped", self.header(leader_ns, "rig"), camera, pose)

    def make(self, kind: str, *values: Any, **fields: Any) -> Any:
        """Create a message, or a part of one."""
        return self._store.types[kind](*values, **fields)

    def header(self, leader_ns: int, frame_id: str) -> Any:
        """Create a header with this time."""
        stamp = self.make("builtin_interfaces/msg/Time", *divmod(leader_ns - self._origin_ns, 1_000_000_000))
        return self.make("std_msgs/msg/Header", stamp, frame_id)

    def add(self, topic: str, kind: str, leader_ns: int, **fields: Any) -> None:
        """Add a message with this arrival time."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        data = self._store.serialize_cdr(self.make(kind, **fields), kind)
        self._writer.write(self._connections[topic], leader_ns - self._origin_ns, data)


def ros_topics(cameras: Iterable[str]) -> dict[str, str]:
    """Return each camera's topic name, valid in ROS: letters, digits and _, no digit first."""
    preferred = {camera: re.sub(r"^(?=\d)", "cam", re.sub(r"\W", "_", camera)) for camera in cameras}
    topics: dict[str, str] = {}
    # A name that is valid in ROS stays unchanged.
    for camera, own in sorted(preferred.items(), key=lambda one: one[0] != one[1]):
        numbered = chain((own,), (f"{own}_{number}" for number in count(2)))
        topics[camera] = next(topic for name in numbered if (topic := f"/{name}") not in topics.values())
    return topics


def _lens(camera: CameraCalibration) -> dict[str, Array]:
    """Return the numbers of a ROS camera_info; Foxglove has the same names in capital letters."""
    matrix = matrix_of(camera)
    projection = np.column_stack([matrix, np.zeros(3)]).ravel()
    return {"d": distortion_of(camera), "k": matrix.ravel(), "r": np.eye(3).ravel(), "p": projection}


def _pose(camera: CameraCalibration, calibration: Calibration) -> tuple[dict[str, float], dict[str, float]]:
    """Return a camera's position in the rig, in metres, and its orientation."""
    centre = centre_of(camera) * METRES.get(calibration.unit, 1.0)
    rotation = dict(zip("wxyz", quaternion(rotation_of(camera).T), strict=True))
    return dict(zip("xyz", centre.tolist(), strict=True)), rotation


EXPORTER = Exporter(
    write=write,
    help="one .mcap for Foxglove and Rerun",
    program="MCAP",
    options=_Options,
    calibration="optional",
    uncalibrated="the session has no calibration: the file has images only",
    unit="m",
    packages=dict.fromkeys(("mcap", "mcap_protobuf", "foxglove_schemas_protobuf"), "export"),
)

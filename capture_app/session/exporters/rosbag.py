"""A ROS 2 bag (MCAP): each camera's compressed images and camera_info, and where cameras are, in /tf_static.

Topics are those of ROS's image_transport: <camera>/image_raw/compressed beside <camera>/camera_info; frames
look along z, as REP 103 has it of optical frames. Written by `rosbags`, as CDR.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.optional_packages import load_optional
from capture_app.session.exchange import ROS_BAGS, ros_messages
from capture_app.session.exporters.common.exported_burst import ExportedBurst
from capture_app.session.exporters.common.files import jpeg_or_png
from capture_app.session.exporters.common.lens import (
    centre_of,
    distortion_of,
    matrix_of,
    quaternion,
    rotation_of,
)
from capture_app.session.exporters.common.tables import unit_note
from capture_app.session.format.calibration import METRES, Calibration, CameraCalibration
from capture_app.session.format.manifest import ImageRecord

_IMAGE, _INFO, _TF = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"


def write_bag(burst: ExportedBurst, folder: Path) -> None:
    """Write <session>/, a bag that `ros2 bag play` takes; stamps, and when messages came, are leader_ns."""
    rosbag2 = load_optional("rosbags.rosbag2", "ros", ROS_BAGS)
    calibration = burst.calibration_or_note("ROS", "the session has no calibration: the bag has images only")
    origin_ns = min(0, burst.origin_ns)
    writer = rosbag2.Writer(folder / burst.name, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    with writer:
        bag = _Bag(writer, ros_messages(), origin_ns)
        images = sorted((i for c in burst.cameras for i in burst.images_of(c)), key=lambda one: one.leader_ns)
        if calibration is not None and images:
            bag.add_rig(images[0].leader_ns, calibration, burst.cameras)
        for number, image in enumerate(images):
            if calibration is not None:
                bag.add_info(image, calibration.cameras[image.camera])
            bag.add_image(image, *jpeg_or_png(burst, image))
            burst.put(image, f"{burst.name}/{burst.name}.mcap", number)
    if origin_ns:
        burst.notes.append(f"stamps count from {origin_ns} ns of the leader's time: ROS's have no sign")
    if calibration is not None:
        burst.notes += unit_note(calibration, "m")


class _Bag:
    def __init__(self, writer: Any, store: Any, origin_ns: int) -> None:
        self._writer, self._store, self._origin_ns = writer, store, origin_ns
        self._connections: dict[str, Any] = {}

    def add_image(self, image: ImageRecord, data: bytes, kind: str) -> None:
        self._add(
            f"/{topic_of(image.camera)}/image_raw/compressed",
            _IMAGE,
            image.leader_ns,
            header=self._header(image.leader_ns, image.camera),
            format=kind,
            data=np.frombuffer(data, np.uint8),
        )

    def add_info(self, image: ImageRecord, camera: CameraCalibration) -> None:
        matrix = np.array(matrix_of(camera), np.float64)
        self._add(
            f"/{topic_of(image.camera)}/camera_info",
            _INFO,
            image.leader_ns,
            header=self._header(image.leader_ns, image.camera),
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            d=np.array(distortion_of(camera), np.float64),
            k=matrix.ravel(),
            r=np.eye(3).ravel(),
            p=np.column_stack([matrix, np.zeros(3)]).ravel(),
            binning_x=0,
            binning_y=0,
            roi=self._make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False),
        )

    def add_rig(self, leader_ns: int, calibration: Calibration, cameras: Sequence[str]) -> None:
        metres = METRES.get(calibration.unit, 1.0)
        transforms = []
        for name in cameras:
            camera = calibration.cameras[name]
            w, x, y, z = quaternion(rotation_of(camera).T)
            place = self._make("geometry_msgs/msg/Vector3", *(float(v) * metres for v in centre_of(camera)))
            transforms.append(
                self._make(
                    "geometry_msgs/msg/TransformStamped",
                    self._header(leader_ns, "rig"),
                    name,
                    self._make(
                        "geometry_msgs/msg/Transform",
                        place,
                        self._make("geometry_msgs/msg/Quaternion", x, y, z, w),
                    ),
                )
            )
        self._add("/tf_static", _TF, leader_ns, transforms=transforms)

    def _make(self, name: str, *values: Any, **fields: Any) -> Any:
        return self._store.types[name](*values, **fields)

    def _header(self, leader_ns: int, frame_id: str) -> Any:
        seconds, nanos = divmod(leader_ns - self._origin_ns, 1_000_000_000)
        return self._make(
            "std_msgs/msg/Header", self._make("builtin_interfaces/msg/Time", seconds, nanos), frame_id
        )

    def _add(self, topic: str, kind: str, leader_ns: int, **fields: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        data = self._store.serialize_cdr(self._make(kind, **fields), kind)
        self._writer.write(self._connections[topic], leader_ns - self._origin_ns, data)


def topic_of(camera: str) -> str:
    """A camera's name as ROS takes it in topics: letters, digits and _, no digit first."""
    return re.sub(r"^(?=\d)", "cam", re.sub(r"\W", "_", camera))

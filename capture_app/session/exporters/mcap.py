"""MCAP: Foxglove's compressed images, calibrations and transforms; one chunk for each set of frames."""

from pathlib import Path
from typing import Any

import msgspec

from capture_app.optional_packages import load_optional
from capture_app.session.exchange import descriptor_set, message_class, with_images_listed
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
from capture_app.session.exporters.rosbag import write_bag
from capture_app.session.format.calibration import METRES, Calibration, CameraCalibration
from capture_app.session.format.checks import indented
from capture_app.session.format.manifest import CALIBRATION, MANIFEST, ImageRecord

_CHUNK = 1 << 62  # a chunk ends where a set of frames does, never by its size


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write <session>.mcap with the topics /<camera>/image, and /<camera>/calibration and /tf if calibrated.

    log_time and publish_time are an image's leader_ns. Images are the session's own bytes, others than JPEG
    and PNG as PNG. The manifest and the calibration are attached.
    """
    if burst.options.ros:
        write_bag(burst, folder)
        return
    writer_module = load_optional("mcap.writer", "export", "MCAP")
    uncalibrated = "the session has no calibration: the file has images only"
    calibration = burst.calibration_or_note("MCAP", uncalibrated)
    file = f"{burst.name}.mcap"
    with (folder / file).open("wb") as stream:
        writer = writer_module.Writer(
            stream, chunk_size=_CHUNK, compression=writer_module.CompressionType.NONE, enable_data_crcs=True
        )
        writer.start(library="simulshot")
        recording = _Recording(writer, min(0, burst.origin_ns))
        for instant in range(len(burst.instants_ns)):
            images = [i for c in burst.cameras for i in burst.images_of(c) if i.instant == instant]
            for image in sorted(images, key=lambda image: image.leader_ns):
                if calibration is not None:
                    recording.add_camera(image, calibration)
                recording.add_image(burst, image)
                burst.put(image, file, len(burst.frames))
            writer.flush()
        for name in (MANIFEST, CALIBRATION) if calibration else (MANIFEST,):
            data = (burst.session.folder / name).read_bytes()
            if name == MANIFEST and burst.session.manifest.videos:
                data = indented(msgspec.json.encode(with_images_listed(burst.session.manifest)))
            writer.add_attachment(0, 0, name, "application/json", data)
        zero = {"session": burst.name, "log_time_zero_leader_ns": str(recording.zero_ns)}
        writer.add_metadata("simulshot", zero)
        writer.finish()
    if calibration is not None:
        burst.notes += unit_note(calibration, "m")


class _Recording:
    """Messages into an MCAP; `zero_ns` is the leader time that log_time, which has no sign, counts from."""

    def __init__(self, writer: Any, zero_ns: int) -> None:
        self._writer = writer
        self.zero_ns = zero_ns
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def add_image(self, burst: ExportedBurst, image: ImageRecord) -> None:
        data, kind = jpeg_or_png(burst, image)
        message = message_class("CompressedImage")(
            timestamp=_time(image.leader_ns), frame_id=image.camera, data=data, format=kind
        )
        self._add(f"/{image.camera}/image", "CompressedImage", message, image)

    def add_camera(self, image: ImageRecord, calibration: Calibration) -> None:
        camera = calibration.cameras[image.camera]
        matrix = matrix_of(camera)
        projection = [*matrix[0], 0.0, *matrix[1], 0.0, *matrix[2], 0.0]
        message = message_class("CameraCalibration")(
            timestamp=_time(image.leader_ns),
            frame_id=image.camera,
            width=camera.width,
            height=camera.height,
            distortion_model="plumb_bob",
            D=distortion_of(camera).tolist(),
            K=matrix.ravel().tolist(),
            R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            P=[float(value) for value in projection],
        )
        self._add(f"/{image.camera}/calibration", "CameraCalibration", message, image)
        transform = _transform(image, camera, METRES.get(calibration.unit, 1.0))
        self._add("/tf", "FrameTransform", transform, image)

    def _add(self, topic: str, name: str, message: Any, image: ImageRecord) -> None:
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(
                f"foxglove.{name}", "protobuf", descriptor_set(name)
            )
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", self._schemas[name])
        time_ns = image.leader_ns - self.zero_ns
        data = message.SerializeToString(deterministic=True)
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns, sequence=image.instant)


def _transform(image: ImageRecord, camera: CameraCalibration, metres: float) -> Any:
    w, x, y, z = quaternion(rotation_of(camera).T)
    centre = [float(value) * metres for value in centre_of(camera)]
    return message_class("FrameTransform")(
        timestamp=_time(image.leader_ns),
        parent_frame_id="rig",
        child_frame_id=image.camera,
        translation={"x": centre[0], "y": centre[1], "z": centre[2]},
        rotation={"x": x, "y": y, "z": z, "w": w},
    )


def _time(leader_ns: int) -> dict[str, int]:
    seconds, nanos = divmod(leader_ns, 1_000_000_000)
    return {"seconds": seconds, "nanos": nanos}

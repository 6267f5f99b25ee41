"""MCAP files of others, by Foxglove's message schemas (docs.foxglove.dev, "Message schemas")."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.plugins.programs.mcap.bags import foxglove_message
from capture_app.session.reading.verify import verify
from tests.imported import import_one
from tests.unit.companions.importing.numbered_video import times_of
from tests.unit.session.conftest import jpeg

TURN = cv2.Rodrigues(np.array([0.0, 0.3, 0.0]))[0]
"""parent_from_camera of the second camera: it looks to its right."""
CENTRE = np.array([0.5, 0.1, -0.2])
START_S = 1_769_865_930


class Recorder:
    """Writes messages of Foxglove's schemas."""

    def __init__(self, path: Path) -> None:
        self._stream = path.open("wb")
        self._writer = Writer(self._stream, compression=CompressionType.NONE)
        self._writer.start(library="somebody's")
        self._channels: dict[str, int] = {}

    def add(self, topic: str, name: str, at_ns: int, **fields: Any) -> None:
        kind = foxglove_message(name)
        if topic not in self._channels:
            schema = register_schema(self._writer, kind)
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        stamp = {"seconds": at_ns // 10**9, "nanos": at_ns % 10**9}
        message = kind(timestamp=stamp, **fields)
        self._writer.add_message(self._channels[topic], at_ns, message.SerializeToString(), at_ns)

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()


def drive(path: Path, *, kind: str = "jpeg", poses: bool = True) -> Path:
    """Two cameras of a car, three frames each, the second one 2 ms later."""
    recorder = Recorder(path)
    half = 0.3 / 2
    turns = {"front": (1.0, 0.0), "right": (float(np.cos(half)), float(np.sin(half)))}
    for k in range(3):
        for n, name in enumerate(("front", "right")):
            at_ns = START_S * 10**9 + k * 33_333_333 + n * 2_000_000
            if poses:
                w, y = turns[name]
                place = dict(zip("xyz", (CENTRE * n).tolist(), strict=True))
                turn = {"x": 0.0, "y": y, "z": 0.0, "w": w}
                frames = {"parent_frame_id": "base_link", "child_frame_id": name}
                recorder.add("/tf", "FrameTransform", at_ns, **frames, translation=place, rotation=turn)
            lens: dict[str, Any] = {"width": 16, "height": 12, "distortion_model": "plumb_bob"}
            lens |= {"K": [20.0, 0, 7.5, 0, 21.0, 5.5, 0, 0, 1], "D": [0.1, 0, 0, 0, 0]}
            recorder.add(f"/{name}/info", "CameraCalibration", at_ns, frame_id=name, **lens)
            image = {"frame_id": name, "data": jpeg(2 * k + n), "format": kind}
            recorder.add(f"/{name}/compressed", "CompressedImage", at_ns, **image)
    recorder.close()
    return path


def test_cameras_times_and_calibration(tmp_path: Path) -> None:
    path = drive(tmp_path / "drive.mcap")
    session = import_one([str(path)], tmp_path, "s", ImportOptions())
    assert verify(session) == []
    assert [sorted(images) for images in session.images_by_instant()] == [["front", "right"]] * 3
    assert times_of(session, "right")[1] == START_S * 10**9 + 33_333_333 + 2_000_000
    last = session.images_by_instant()[2]["right"]
    assert session.image_file(last).read_bytes() == jpeg(5)
    found = session.calibration()
    assert found is not None
    assert found.unit == "m"
    camera = found.cameras["right"]
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (20, 21, 7.5, 5.5)
    assert np.array(camera.rotation) == pytest.approx(TURN.T, abs=1e-9)
    assert -TURN @ np.array(camera.translation) == pytest.approx(CENTRE)


def test_without_poses_there_is_no_calibration(tmp_path: Path) -> None:
    session = import_one([str(drive(tmp_path / "drive.mcap", poses=False))], tmp_path, "s", ImportOptions())
    assert session.calibration() is None


def test_what_cannot_be_read_is_said(tmp_path: Path) -> None:
    path = drive(tmp_path / "drive.mcap", kind="webp")
    with pytest.raises(BadInputError, match="format 'webp'; JPEG and PNG are read"):
        import_one([str(path)], tmp_path, "s", ImportOptions())
    whole = drive(tmp_path / "drive.mcap").read_bytes()
    for name, data in (("cut", whole[: len(whole) // 2]), ("other", b"nothing of that"), ("empty", b"")):
        broken = tmp_path / f"{name}.mcap"
        broken.write_bytes(data)
        with pytest.raises(BadInputError, match=f"{name}.mcap"):
            import_one([str(broken)], tmp_path, "s", ImportOptions())
    recorder = Recorder(tmp_path / "tf.mcap")
    recorder.add("/tf", "FrameTransform", 1, parent_frame_id="a", child_frame_id="b")
    recorder.close()
    with pytest.raises(BadInputError, match=r"no foxglove\.CompressedImage"):
        import_one([str(tmp_path / "tf.mcap")], tmp_path, "s", ImportOptions())

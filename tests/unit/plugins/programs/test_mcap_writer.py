"""MCAP, read back by the mcap package with its protobuf decoder."""

from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from capture_app.session.format.manifest import CALIBRATION, MANIFEST
from tests.unit.plugins.programs.conftest import GRID, Export, Make, calibrated


def test_images_calibrations_and_times(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    export(session, "mcap")
    images = {(i.camera, i.leader_ns): i for i in session.manifest.images}
    seen = set()
    with (tmp_path / "out" / "clap.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert len(summary.chunk_indexes) == len(GRID)
        assert {schema.name for schema in summary.schemas.values()} == {
            "foxglove.CompressedImage",
            "foxglove.CameraCalibration",
            "foxglove.FrameTransform",
        }
        for schema, channel, message, content in reader.iter_decoded_messages():
            assert schema is not None
            time_ns = content.timestamp.seconds * 10**9 + content.timestamp.nanos
            assert message.log_time == message.publish_time == time_ns
            if schema.name == "foxglove.CompressedImage":
                image = images[content.frame_id, message.log_time]
                assert channel.topic == f"/{image.camera}/image"
                assert content.format == "jpeg"
                assert content.data == session.image_file(image).read_bytes()
                seen.add(image)
            elif schema.name == "foxglove.CameraCalibration":
                truth = calibrated(content.frame_id)
                assert list(content.K) == [truth.fx, 0, truth.cx, 0, truth.fy, truth.cy, 0, 0, 1]
                assert list(content.D) == list(truth.distortion)
                assert (content.width, content.height) == (truth.width, truth.height)
                assert (len(content.R), len(content.P)) == (9, 12)
            else:
                truth = calibrated(content.child_frame_id)
                q = content.rotation
                rotation = _rotation(q.w, q.x, q.y, q.z)
                assert rotation == pytest.approx(np.array(truth.rotation).T, abs=1e-12)
                centre = [content.translation.x, content.translation.y, content.translation.z]
                assert centre == pytest.approx(-rotation @ np.array(truth.translation), abs=1e-12)
        attached = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        assert attached == {name: (session.folder / name).read_bytes() for name in (MANIFEST, CALIBRATION)}
    assert seen == set(images.values())


def test_what_was_written_before_a_cut_can_be_read(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(missing=()), "mcap")
    path = tmp_path / "out" / "clap.mcap"
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    third = sorted(index.chunk_start_offset for index in summary.chunk_indexes)[2]
    path.write_bytes(path.read_bytes()[: third + 100])
    count = 0
    with path.open("rb") as stream, suppress(McapError, EOFError):
        for record in StreamReader(stream).records:
            count += type(record).__name__ == "Message"
    assert count == 2 * 3 * 3  # two sets, three cameras, three topics


def test_clocks_below_zero_and_other_files(make: Make, export: Export, tmp_path: Path) -> None:
    session = make(start_ns=-5_000_000_000, suffixes={"mid": ".tiff"}, calibrate=())
    report = export(session, "mcap")
    first_ns = min(image.leader_ns for image in session.manifest.images)
    with (tmp_path / "out" / "clap.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        (metadata,) = reader.iter_metadata()
        assert metadata.metadata["log_time_zero_leader_ns"] == str(first_ns)
        for _, _, message, content in reader.iter_decoded_messages():
            time_ns = content.timestamp.seconds * 10**9 + content.timestamp.nanos
            assert time_ns == message.log_time + first_ns
            assert cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_COLOR) is not None
            assert content.format == ("png" if content.frame_id == "mid" else "jpeg")
    assert "no calibration" in report.notes[-1]


def _rotation(w: float, x: float, y: float, z: float) -> np.ndarray:
    cross = np.cross([x, y, z], np.eye(3)).T
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross

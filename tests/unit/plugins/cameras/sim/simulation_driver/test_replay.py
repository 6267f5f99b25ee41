"""A camera that replays an MJPEG file gives each of its pictures as it is in the file."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.common.clock import HostClock
from capture_app.common.errors import BadInputError
from capture_app.plugins.cameras.sim.rendering.picture_source import Replay
from capture_app.plugins.cameras.sim.sensor import SensorFrame
from capture_app.plugins.cameras.sim.simulation_driver import open_camera


def jpeg(grey: int, width: int = 64) -> bytes:
    return bytes(cv2.imencode(".jpg", np.full((48, width, 3), grey, np.uint8))[1].tobytes())


def frame(sequence: int) -> SensorFrame:
    return SensorFrame(
        sequence=sequence,
        stream=0,
        start_true_ns=0,
        exposure_ns=1,
        timestamp_true_ns=0,
        readout_end_true_ns=0,
        dropped=False,
    )


def test_the_pictures_of_a_file_come_one_after_the_other_and_again(tmp_path: Path) -> None:
    file = tmp_path / "three.mjpeg"
    file.write_bytes(jpeg(10) + jpeg(90) + jpeg(200))
    replay = Replay.open(file)
    assert (replay.width, replay.height) == (64, 48)
    assert [replay.jpeg(frame(n)) for n in range(4)] == [jpeg(10), jpeg(90), jpeg(200), jpeg(10)]
    assert replay.jpeg(frame(0)) is not replay.jpegs[0], "a driver copies its buffer"
    assert abs(int(replay.render(frame(1), seed=0).mean()) - 90) <= 1
    camera = open_camera("phone-a", {"replay": str(file)}, clock=HostClock(), name="cam00")
    assert (camera.facts.width, camera.facts.height) == (64, 48)


def test_sound_that_looks_like_the_border_of_two_pictures_is_none(tmp_path: Path) -> None:
    segment = b"\xff\xe9\x00\x08ab\xff\xd9\xff\xd8"
    loud = [jpeg(grey)[:2] + segment + jpeg(grey)[2:] for grey in (10, 90)]
    (file := tmp_path / "two.mjpeg").write_bytes(b"".join(loud))
    assert Replay.open(file).jpegs == tuple(loud)


@pytest.mark.parametrize(
    ("data", "says"), [(b"no picture", "not a series of JPEGs"), (jpeg(1) + jpeg(1, 80), "of one size")]
)
def test_a_file_that_is_no_such_video_is_refused(tmp_path: Path, data: bytes, says: str) -> None:
    file = tmp_path / "odd.mjpeg"
    file.write_bytes(data)
    with pytest.raises(BadInputError, match=says):
        Replay.open(file)
    with pytest.raises(BadInputError, match="cannot read"):
        Replay.open(tmp_path / "none.mjpeg")
    with pytest.raises(BadInputError, match="has no scene"):
        open_camera("phone-a", {"replay": str(file), "scene": "studio"}, clock=HostClock(), name="cam00")

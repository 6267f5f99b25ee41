"""Two views in each picture, side by side, as stereo cameras write them."""

from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_app.cli import run
from capture_app.session.reading.reader import Session

SHIFT = 6
"""Disparity of the two views, px."""


def scene(seed: int) -> NDArray[np.uint8]:
    coarse = np.random.default_rng(seed).integers(0, 256, (9, 18, 3), np.uint8)
    return np.ascontiguousarray(cv2.resize(coarse, (128 + SHIFT, 64), interpolation=cv2.INTER_CUBIC))


def stereo(seed: int) -> NDArray[np.uint8]:
    return np.hstack([scene(seed)[:, SHIFT:], scene(seed)[:, :-SHIFT]])


def write(path: Path, pictures: list[NDArray[np.uint8]]) -> None:
    path.parent.mkdir(parents=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.bit_rate = 256, 64, 4_000_000
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))


def imported(folder: Path, out: Path, *options: str) -> Session:
    assert run(["sessions", "import", str(folder), "--out", str(out), *options]) == 0
    return Session.open(out / folder.name)


def test_two_views_are_two_cameras_of_one_instant(tmp_path: Path) -> None:
    write(tmp_path / "in" / "zed.mp4", [stereo(n) for n in range(4)])
    session = imported(tmp_path / "in", tmp_path / "out", "--split", "side-by-side")
    assert [camera.name for camera in session.manifest.cameras] == ["zed-left", "zed-right"]
    times = session.manifest.burst.common_times
    assert times is not None
    assert (times.state, times.reason) == ("recorded", "both views are in each picture")
    for instant, images in enumerate(session.images_by_instant()):
        left, right = (
            cv2.imread(str(session.image_file(images[f"zed-{side}"]))) for side in ("left", "right")
        )
        assert left is not None
        assert right is not None
        assert left.shape == right.shape == (64, 128, 3)
        assert images["zed-left"].leader_ns == images["zed-right"].leader_ns
        # Where the left view shows something, the right one does so further to the right.
        assert np.abs(left[:, :-SHIFT].astype(int) - right[:, SHIFT:]).mean() < 8
        assert np.abs(left.astype(int) - stereo(instant)[:, :128]).mean() < 8


@pytest.mark.parametrize("two", [True, False])
def test_a_repeated_view_is_a_question(tmp_path: Path, two: bool, capsys: pytest.CaptureFixture[str]) -> None:
    one_view = np.hstack([scene(5)[:, SHIFT:], scene(6)[:, SHIFT:]])
    write(tmp_path / "in" / "zed.mp4", [stereo(5) if two else one_view] * 4)
    session = imported(tmp_path / "in", tmp_path / "out")
    assert [camera.name for camera in session.manifest.cameras] == ["zed"]
    assert ("import again with --split side-by-side" in capsys.readouterr().err) == two


def test_views_of_several_cameras_have_the_times_of_these(tmp_path: Path) -> None:
    for name in ("a", "b"):
        for number in range(2):
            (tmp_path / "in" / name).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(tmp_path / "in" / name / f"{number}.png"), stereo(number))
    session = imported(tmp_path / "in", tmp_path / "out", "--split", "side-by-side", "--fps", "30")
    assert [camera.name for camera in session.manifest.cameras] == ["a-left", "a-right", "b-left", "b-right"]
    assert [len(images) for images in session.images_by_instant()] == [4, 4]
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.state == "given"

"""Sessions of fisheyes: their images are redrawn for perspective lenses, and depth is of what these see."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.scene import scene as product
from tests.unit.reconstruction.conftest import VIEWS, Reconstruct, Scene, write_session

WIDE = {
    name: replace(
        view,
        matrix=np.array([[140.0, 0, 159.5], [0, 140.0, 119.5], [0, 0, 1]]),
        distortion=np.array([-0.02, 0.004, 0.0, 0.0]),
        is_fisheye=True,
    )
    for name, view in VIEWS.items()
}


@pytest.fixture(scope="module")
def wide(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Session:
    return write_session(tmp_path_factory.mktemp("fisheyes"), scene, WIDE, instants=1)


def test_images_and_truth_are_redrawn_for_a_perspective_lens(
    wide: Session, scene: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    opened = product.Scene.open(wide.folder)
    view = opened.views["left"]
    assert view.lens.is_straight
    assert np.degrees(2 * np.arctan(view.width / 2 / view.focal)) == pytest.approx(100, abs=0.5)
    assert "left is a fisheye: the outer " in capsys.readouterr().err
    depth, _ = opened.dataset.ground_truth("left", 0)
    redrawn = opened.dataset.grey("left", 0).astype(float)
    image, true_depth = (np.asarray(a) for a in scene.look(view, 0.0)[:2])
    assert np.median(np.abs(redrawn - image)) < 8
    assert np.mean(np.abs(depth / true_depth - 1) < 0.02) > 0.95


def test_depth_of_fisheyes_is_right_where_the_redrawn_images_see(
    wide: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    assert reconstruct("stereo", wide.folder, "--out", tmp_path / "depth").code == 0


def test_what_is_known_of_a_fisheye_is_checked_against_its_images(
    wide: Session, reconstruct: Reconstruct
) -> None:
    checked = reconstruct("calibrate", wide.folder, "--from", "session", "--json")
    assert checked.code == 0, checked.err
    assert msgspec.json.decode(checked.out)["quality"]["inlier_share"] > 0.6

"""Sessions of fisheyes: their images are redrawn for perspective lenses, and depth is of what these see."""

import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from capture_app.session.format.lens import Lens, lens_of
from capture_app.session.reading.reader import Session
from reconstruction.scene import scene as product
from tests.unit.reconstruction import conftest
from tests.unit.reconstruction.conftest import (
    VIEWS,
    Board,
    Reconstruct,
    Scene,
    make_view,
    texture,
    write_session,
)

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
    assert "left is a fisheye: 100 of its 1" in capsys.readouterr().err
    depth, _ = opened.dataset.ground_truth("left", 0)
    redrawn = opened.dataset.grey("left", 0).astype(float)
    image, true_depth = (np.asarray(a) for a in scene.look(view, 0.0)[:2])
    assert np.median(np.abs(redrawn - image)) < 8
    assert np.mean(np.abs(depth / true_depth - 1) < 0.02) > 0.95


def test_redrawing_keeps_what_is_fine(tmp_path: Path) -> None:
    """Waves of some pixels lose 12 grey values, in the median, to bilinear interpolation."""
    across, down = np.meshgrid(*[60 * np.sin(np.arange(513) * 2 * np.pi / 64)] * 2)
    waves = Scene([Board((-40, -40, 40, 40), 6.0, np.asarray(128 + across + down, np.uint8))], noise=0.0)
    session = write_session(tmp_path, waves, {"left": WIDE["left"]}, instants=1, truth=False)
    opened = product.Scene.open(session.folder)
    redrawn = opened.dataset.grey("left", 0).astype(float)
    assert np.median(np.abs(redrawn - waves.look(opened.views["left"], 0.0)[0])) < 6


def test_depth_of_fisheyes_is_right_where_the_redrawn_images_see(
    wide: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    assert reconstruct("stereo", wide.folder, "--out", tmp_path / "depth").code == 0


@pytest.mark.parametrize("source", ["session", "calibration.json"])
def test_what_is_known_of_a_fisheye_is_checked_against_its_images(
    wide: Session, tmp_path: Path, reconstruct: Reconstruct, source: str
) -> None:
    session = shutil.copytree(wide.folder, tmp_path / wide.folder.name)
    given = source if source == "session" else shutil.move(session / source, tmp_path)
    checked = reconstruct("calibrate", session, "--from", given, "--no-keep", "--json")
    assert checked.code == 0, checked.err
    assert msgspec.json.decode(checked.out)["quality"]["inlier_share"] > 0.6
    assert Session.open(session).calibration().cameras["left"].is_fisheye


@pytest.mark.parametrize(
    ("focal_px", "distortion", "given", "contradiction"),
    [
        (211.0, (-0.02, 0.004, -0.001, 0.0003), "118", "118.0 degrees were given; the pictures say 1"),
        # By its focal length alone, it would see 192 degrees.
        (143.2, (0.1026, 0.0, 0.0, 0.0), "160", ""),
    ],
)
def test_lenses_are_found_from_images(
    tmp_path: Path,
    reconstruct: Reconstruct,
    monkeypatch: pytest.MonkeyPatch,
    focal_px: float,
    distortion: tuple[float, ...],
    given: str,
    contradiction: str,
) -> None:
    """A rig of five whose field of view, 130 degrees, was given 12 degrees too small, and 160 right."""
    for name, value in (("WIDTH", 480), ("HEIGHT", 360), ("TEXELS", 60)):
        monkeypatch.setattr(conftest, name, value)
    rng = np.random.default_rng(7)
    boards = [Board((-40.0, -40.0, 40.0, 40.0), 5.0, texture(1))]
    for number in range(26):
        z = float(rng.uniform(1.8, 4.5))
        x, y, w, h = z * rng.uniform((-1.9, -1.4, 0.15, 0.15), (1.9, 1.4, 0.4, 0.4))
        boards.append(Board((x - w, y - h, x + w, y + h), z, texture(10 + number)))
    true = Lens(
        np.array([[focal_px, 0, 241.0], [0, focal_px, 178.0], [0, 0, 1]]),
        np.array(distortion),
        is_fisheye=True,
    )
    rig = {
        f"cam{n}": replace(
            make_view((0.3 * (n - 2), 0.06 * (n % 2), 0.05 * (n % 3)), yaw=-4.0 * (n - 2)),
            matrix=true.matrix,
            distortion=true.distortion,
            is_fisheye=True,
        )
        for n in range(5)
    }
    session = write_session(tmp_path, Scene(boards), rig, instants=2, calibrated=False, truth=False)
    refused = reconstruct("calibrate", session.folder, "--lens", "fisheye")
    assert "fisheyes are found from images only with their field of view" in refused.complaint
    found = reconstruct("calibrate", session.folder, "--lens", "fisheye", "--field-of-view", given, "--json")
    source = found.result["source"]
    assert contradiction in source if contradiction else "were given" not in source
    for camera in Session.open(session.folder).calibration().cameras.values():
        assert camera.is_fisheye
        assert camera.fx == pytest.approx(focal_px, rel=0.02)
        pixels = np.array([[241.0, 20.0], [60.0, 178.0], [450.0, 300.0]])
        rays = (np.column_stack([lens.rays(pixels), np.ones(3)]) for lens in (lens_of(camera), true))
        ours, theirs = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
        assert np.degrees(np.arccos((ours * theirs).sum(1))).max() < 1.0

"""Fisheyes in exports: other programs and our own readers find the same rays."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.exporting.export_session import export_session
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.lens import lens_of
from capture_app.session.importing.calibrations import fit_calibration, read_views
from capture_app.session.reading.reader import Session
from tests.unit.plugins.programs.conftest import Make, make  # noqa: F401

FILES = {"colmap": "sparse/0", "nerfstudio": "transforms.json", "caliscope": "camera_array.toml"}
"""The calibration in each export."""


@pytest.fixture
def wide(make: Make) -> Session:  # noqa: F811
    session = make()
    cameras = {
        name: msgspec.structs.replace(
            lens,
            fx=0.4 * lens.width,
            fy=0.41 * lens.width,
            model="fisheye",
            distortion=(-0.02, 0.004, -0.001, 0.0003),
        )
        for name, lens in session.calibration().cameras.items()
    }
    calibration = Calibration(cameras=cameras, unit="m")
    (session.folder / "calibration.json").write_bytes(msgspec.json.encode(calibration))
    return Session.open(session.folder)


@pytest.mark.parametrize("to", FILES)
def test_lenses_come_back(wide: Session, to: str, tmp_path: Path) -> None:
    export_session(wide, to, tmp_path / to)
    cameras = wide.calibration().cameras
    # Caliscope's cameras are numbers.
    before = {str(n): lens for n, lens in enumerate(cameras.values())} if to == "caliscope" else cameras
    sizes = {name: (lens.width, lens.height) for name, lens in before.items()}
    found = fit_calibration(read_views([("", tmp_path / to / FILES[to])], [*sizes]), sizes).cameras
    for name, lens in before.items():
        assert found[name].is_fisheye
        pixels = np.array([[0.0, 0.0], [lens.width / 3, lens.height - 1.0]])
        assert np.abs(lens_of(found[name]).rays(pixels) - lens_of(lens).rays(pixels)).max() < 1e-6


def test_colmap_has_the_same_rays(wide: Session, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    export_session(wide, "colmap", tmp_path / "colmap", instant=0)
    model = pycolmap.Reconstruction(tmp_path / "colmap" / "sparse" / "0")
    assert {camera.model.name for camera in model.cameras.values()} == {"OPENCV_FISHEYE"}
    for image in model.images.values():
        name = next(one for one in wide.calibration().cameras if one in image.name)
        lens = wide.calibration().cameras[name]
        pixels = np.array([[1.0, 2.0], [lens.width / 3, lens.height - 1.0]])
        rays = lens_of(lens).rays(pixels)
        assert np.abs(image.camera.cam_from_img(pixels + 0.5) - rays).max() < 1e-6


def test_an_export_that_has_no_fisheyes_says_what_has(wide: Session, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"is a fisheye, which the export to .* cannot have .*splats"):
        export_session(wide, "pose2sim", tmp_path / "out")

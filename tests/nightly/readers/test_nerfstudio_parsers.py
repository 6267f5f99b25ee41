"""Exports opened by nerfstudio's own data parsers: their rays pass the dots in the pictures.

Skipped unless nerfstudio is installed. It needs CUDA only to train: `pip install --no-deps nerfstudio` and
`pip install torch jaxtyping`, without CUDA, are enough here.
"""

import importlib
import importlib.util
import sys
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import cv2
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.exporting.point_cloud import PointCloud, write_ply
from capture_app.session.reading.reader import Session
from tests.unit.plugins.programs.dotted import Array, build, farthest_off

pytestmark = pytest.mark.filterwarnings("ignore")  # of PyTorch, about what nerfstudio does
UNUSED = ("appdirs", "imageio", "rawpy", "viser")
"""Packages that nerfstudio's parsers import and do not call."""
EXACT_PX, RESAMPLED_PX = 0.01, 0.05
CLOUD = np.random.default_rng(0).uniform(-0.2, 0.2, (200, 3))


@pytest.fixture
def parsers(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a parser's outputs: of the name of its module, of its configuration's class, and its options."""
    for package in ("nerfstudio", "torch", "jaxtyping"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    for name in [name for name in UNUSED if importlib.util.find_spec(name) is None]:
        monkeypatch.setitem(sys.modules, name, MagicMock())
        monkeypatch.setitem(sys.modules, f"{name}.transforms", MagicMock())
    # Its logs of a training run, for TensorBoard and others.
    monkeypatch.setitem(sys.modules, "nerfstudio.utils.writer", MagicMock())

    def outputs(name: str, **options: Any) -> Any:
        module = importlib.import_module(f"nerfstudio.data.dataparsers.{name.lower()}_dataparser")
        config = getattr(module, f"{name}DataParserConfig")(**options)
        return config.setup().get_dataparser_outputs(split="train")

    return outputs


@pytest.fixture
def session(tmp_path: Path) -> Session:
    write_ply(tmp_path / "cloud.ply", PointCloud(CLOUD, np.full(CLOUD.shape, 90, np.uint8)))
    return build(tmp_path / "sessions")


def moved(outputs: Any, points: Array) -> Array:
    """Return points of the rig (n, 3) where the parser has them, after it turned, centred and scaled all."""
    transform = outputs.dataparser_transform.numpy().astype(float)
    return np.asarray(outputs.dataparser_scale * (points @ transform[:, :3].T + transform[:, 3]))


def farthest(outputs: Any, number: int) -> float:
    """Return the largest distance, px, between a picture's dots and the parser's rays to the points."""
    torch: Any = importlib.import_module("torch")
    shown = cv2.imread(str(outputs.image_filenames[number]))
    height, width = shown.shape[:2]
    assert (outputs.cameras.width[number], outputs.cameras.height[number]) == (width, height)
    pose = outputs.cameras.camera_to_worlds[number].numpy().astype(float)

    def in_camera(vectors: Array) -> Array:
        """Return x/z and y/z of vectors (n, 3) in OpenCV's axes; nerfstudio's look along -z with y up."""
        x, y, z = (vectors @ pose[:, :3]).T
        return np.stack([x / -z, y / z], axis=1)

    def rays(pixels: Array) -> Array:
        coords = torch.from_numpy(np.asarray(pixels)[:, ::-1] + 0.5).float()
        bundle = outputs.cameras.generate_rays(camera_indices=number, coords=coords)
        return in_camera(bundle.directions.numpy().astype(float))

    def project(point: Array) -> Array:
        """Return the pixel whose ray goes to the point, by search."""
        target = in_camera(moved(outputs, point[None]) - pose[:, 3])
        pixel = np.array([width / 2, height / 2])
        for _ in range(20):
            near = rays(pixel + np.array([[0, 0], [1, 0], [0, 1]]))
            pixel = pixel + np.linalg.solve((near[1:] - near[0]).T, target[0] - near[0])
        return pixel

    return farthest_off(shown, project, rays)


def test_transforms(session: Session, tmp_path: Path, parsers: Any) -> None:
    out = tmp_path / "out"
    export_session(session, "nerfstudio", out, instant=1, points=tmp_path / "cloud.ply")
    outputs = parsers("Nerfstudio", data=out, eval_mode="all", load_3D_points=True)
    assert [file.parent.name for file in outputs.image_filenames] == ["cam10", "cam9"]
    assert max(farthest(outputs, 0), farthest(outputs, 1)) < EXACT_PX
    assert outputs.metadata["points3D_xyz"].numpy() == pytest.approx(moved(outputs, CLOUD), abs=1e-5)


def test_splats(session: Session, tmp_path: Path, parsers: Any) -> None:
    out = tmp_path / "out"
    export_session(session, "splats", out, lossless=True, points=tmp_path / "cloud.ply")
    outputs = parsers("Colmap", data=out, eval_mode="all", colmap_path=Path("sparse/0"))
    assert len(outputs.image_filenames) == 2
    assert max(farthest(outputs, 0), farthest(outputs, 1)) < RESAMPLED_PX
    assert outputs.metadata["points3D_xyz"].numpy() == pytest.approx(moved(outputs, CLOUD), abs=1e-5)

"""What may come with the pictures: points, masks, one instant only, videos without loss."""

import json
from pathlib import Path

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.plugins.programs.n3dv import POINTS
from capture_app.session.exporting.point_cloud import read_ply
from capture_app.session.reading.reader import Session
from tests.unit.plugins.programs.conftest import Export, Make
from tests.unit.plugins.programs.test_points_and_masks import (
    CLOUD,
    cloud,  # noqa: F401 - a fixture
    whole,  # noqa: F401 - a fixture
)


def test_points_are_read_as_other_programs_write_them(tmp_path: Path, cloud: Path) -> None:
    o3d = pytest.importorskip("open3d")
    seen = o3d.io.read_point_cloud(str(cloud))
    assert np.asarray(seen.points) == pytest.approx(CLOUD.points)
    assert np.rint(np.asarray(seen.colors) * 255).astype(int).tolist() == CLOUD.colours.tolist()
    for ascii_too in (False, True):
        o3d.io.write_point_cloud(str(tmp_path / "theirs.ply"), seen, write_ascii=ascii_too)
        back = read_ply(tmp_path / "theirs.ply")
        assert back.points == pytest.approx(CLOUD.points)
        assert back.colours.tolist() == CLOUD.colours.tolist()


def test_points_where_a_format_holds_them(
    whole: Session, export: Export, cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    export(whole, "nerfstudio", points=cloud)
    content = json.loads((out / "transforms.json").read_text())
    assert read_ply(out / content["ply_file_path"]).points == pytest.approx(CLOUD.points)
    out.rename(tmp_path / "first")
    export(whole, "colmap", points=cloud)
    pycolmap = pytest.importorskip("pycolmap")
    points = pycolmap.Reconstruction(str(out / "sparse" / "0")).points3D
    assert np.array([points[number].xyz for number in (1, 2, 3)]) == pytest.approx(CLOUD.points)
    assert [points[number].color.tolist() for number in (1, 2, 3)] == CLOUD.colours.tolist()
    out.rename(tmp_path / "second")
    report = export(whole, "n3dv", points=cloud, near=0.1, far=3.0)
    assert read_ply(out / POINTS).points == pytest.approx(CLOUD.points)
    assert not any("random points" in note for note in report.notes)


def test_a_distortion_that_no_lens_has(make: Make, export: Export) -> None:
    session = make()
    path = session.folder / "calibration.json"
    content = json.loads(path.read_text())
    content["cameras"]["right"]["distortion"] = [-50.0, 0.0, 0.0, 0.0, -1e4]
    path.write_text(json.dumps(content))
    for name in ("n3dv", "freemocap", "easyvolcap"):
        with pytest.raises(BadInputError, match="its distortion folds the picture"):
            export(Session.open(session.folder), name)

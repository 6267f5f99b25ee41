"""nerfstudio's and N3DV's layouts, read as their loaders read them."""

import json
from pathlib import Path

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.pinhole import focus_depths
from tests.unit.plugins.programs.conftest import (
    HEIGHT,
    POINT,
    START_NS,
    WIDTH,
    Export,
    Make,
    calibrated,
    spot,
)


def test_transforms(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    export(session, "nerfstudio")
    content = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert content["camera_model"] == "OPENCV"
    assert len(content["frames"]) == len(session.manifest.images) == 11
    exact = {(image.camera, image.instant): image.leader_ns for image in session.manifest.images}
    for frame in content["frames"]:
        camera = calibrated(frame["camera"])
        assert (tmp_path / "out" / frame["file_path"]).is_file()
        assert (frame["w"], frame["h"]) == (WIDTH, HEIGHT)
        assert frame["leader_ns"] == exact[frame["camera"], frame["instant"]]
        since_ns = frame["leader_ns"] - content["time_origin_leader_ns"]
        assert frame["time"] * content["time_span_ns"] == pytest.approx(since_ns, abs=1e-3)
        # OpenGL's camera looks along -z with y up.
        x, y, z, _ = np.linalg.inv(np.array(frame["transform_matrix"])) @ [*POINT, 1]
        u, v = x / -z, -y / -z
        square = u * u + v * v
        radial = 1 + frame["k1"] * square + frame["k2"] * square**2 + frame["k3"] * square**3
        p1, p2 = frame["p1"], frame["p2"]
        u_seen = u * radial + 2 * p1 * u * v + p2 * (square + 2 * u * u)
        v_seen = v * radial + 2 * p2 * u * v + p1 * (square + 2 * v * v)
        pixel = (frame["fl_x"] * u_seen + frame["cx"], frame["fl_y"] * v_seen + frame["cy"])
        assert pixel == pytest.approx(np.array(spot(camera)) + 0.5, abs=1e-9)
    times = [frame["time"] for frame in content["frames"]]
    assert (min(times), max(times)) == (0.0, 1.0)


def test_one_instant_has_one_time(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(missing=tuple((c, i) for c in ("left", "mid", "right") for i in (1, 2, 3))), "nerfstudio")
    content = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert [frame["time"] for frame in content["frames"]] == [0.0, 0.0, 0.0]


def test_what_n3dv_cannot_hold(make: Make, export: Export) -> None:
    with pytest.raises(BadInputError, match="is not less than"):
        export(make(name="deep"), "n3dv", near=3.0, far=3.0)
    missing = tuple((name, i) for i, name in enumerate(("left", "mid", "right", "left")))
    with pytest.raises(BadInputError, match="no instant"):
        export(make(name="gappy", missing=missing), "n3dv")


def test_where_the_cameras_look() -> None:
    # All three look at the rig's origin, give or take the few centimetres that they stand aside.
    depths = focus_depths({name: calibrated(name) for name in ("left", "mid", "right")})
    assert list(depths.values()) == pytest.approx([0.5] * 3, abs=0.03)
    alone = focus_depths({"mid": calibrated("mid")})
    assert alone == {"mid": 1.0}


def test_the_earliest_image_is_zero(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(), "nerfstudio")
    content = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert content["time_origin_leader_ns"] == START_NS - 8_765

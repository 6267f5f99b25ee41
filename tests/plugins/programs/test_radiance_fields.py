"""nerfstudio's and N3DV's layouts, read as their loaders read them."""

import json
import shutil
from pathlib import Path

import av
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.pinhole import focus_depths
from capture_app.session.reading.reader import Session
from tests.plugins.programs.conftest import (
    GRID,
    HEIGHT,
    PERIOD_NS,
    POINT,
    START_NS,
    WIDTH,
    Export,
    Make,
    calibrated,
    grey,
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


@pytest.mark.slow
def test_n3dv(make: Make, export: Export, tmp_path: Path) -> None:
    report = export(make(), "n3dv", near=0.1, far=3.0)
    out = tmp_path / "out"
    videos = sorted(path.name for path in out.glob("cam*.mp4"))
    assert videos == ["cam00.mp4", "cam01.mp4", "cam02.mp4"]
    rows = np.load(out / "poses_bounds.npy")
    assert rows.shape == (3, 17)
    assert rows[:, 15:].tolist() == [[0.1, 3.0]] * 3
    poses = rows[:, :15].reshape(3, 3, 5)
    assert np.array_equal(poses[0, :, 4], poses[1, :, 4])
    for file, pose, name in zip(videos, poses, ("left", "mid", "right"), strict=True):
        height, width, focal = pose[:, 4]
        assert (width, height) == (2704, 2028)
        # As NeRF's loaders turn LLFF's [down, right, back] into [right, up, back].
        camera_to_world = np.stack([pose[:, 1], -pose[:, 0], pose[:, 2]], axis=1)
        x, y, z = camera_to_world.T @ (POINT - pose[:, 3])
        expected = (focal * x / -z + width / 2, focal * -y / -z + height / 2)
        with av.open(str(out / file)) as container:
            pictures = [frame.to_ndarray(format="gray") for frame in container.decode(video=0)]
        assert len(pictures) == 2  # instants 1 and 2 are incomplete
        assert [int(picture[100, 250]) for picture in pictures] == pytest.approx(
            [grey(name, 0), grey(name, 3)], abs=4
        )
        brightness = pictures[0].astype(float) - grey(name, 0)
        brightness[brightness < 20] = 0
        rows_, columns = np.mgrid[:2028, :2704]
        seen = [float((brightness * axis).sum() / brightness.sum()) + 0.5 for axis in (columns, rows_)]
        assert seen == pytest.approx(expected, abs=0.35 * 2704 / WIDTH)
    assert any("2 of 4 instants are left out" in note for note in report.notes)
    assert not any("guessed" in note for note in report.notes)
    assert "cam01 is mid" in report.notes


@pytest.mark.slow
def test_n3dv_says_only_which_cameras_it_renames(export: Export, tmp_path: Path) -> None:
    sample = Path(__file__).parents[3] / "sample_sessions" / "jumper"
    shutil.copytree(sample, tmp_path / "jumper")
    path = tmp_path / "jumper" / "session.json"
    content = json.loads(path.read_text())
    content["images"] = [image for image in content["images"] if image["instant"] == 0]
    path.write_text(json.dumps(content))
    session = Session.open(tmp_path / "jumper")
    assert session.manifest.cameras[0].name == "cam00"
    report = export(session, "n3dv", near=0.1, far=9.0)
    renamed = [note.split(" is ") for note in report.notes if note.startswith("cam")]
    assert ["cam02", "cam04"] in renamed
    assert all(old != new for new, old in renamed)


@pytest.mark.slow
def test_n3dv_counts_instants_not_images(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(missing=(), substitutes={}), "n3dv")
    with av.open(str(tmp_path / "out" / "cam01.mp4")) as container:
        times = [round(frame.pts * frame.time_base * 10**6) for frame in container.decode(video=0)]
    assert times == [(slot * PERIOD_NS + 500) // 1000 for slot in GRID]


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

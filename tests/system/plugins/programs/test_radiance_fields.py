"""nerfstudio's and N3DV's layouts, read as their loaders read them."""

import json
import shutil
from pathlib import Path

import av
import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from tests.project import JUMPER
from tests.unit.plugins.programs.conftest import (
    GRID,
    PERIOD_NS,
    POINT,
    WIDTH,
    Export,
    Make,
    grey,
)


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


def test_n3dv_says_only_which_cameras_it_renames(export: Export, tmp_path: Path) -> None:
    sample = JUMPER
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


def test_n3dv_counts_instants_not_images(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(missing=(), substitutes={}), "n3dv")
    with av.open(str(tmp_path / "out" / "cam01.mp4")) as container:
        times = [round(frame.pts * frame.time_base * 10**6) for frame in container.decode(video=0)]
    assert times == [(slot * PERIOD_NS + 500) // 1000 for slot in GRID]

"""The study of all cameras with true maps: what is measured of late images, and what is shown."""

from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.session.exporting.point_cloud import read_ply
from capture_app.session.reading.reader import Session
from reconstruction.scene.conditions import Condition
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.methods.multiview.test_study_of_true_maps import LATE, both, prepared
from tests.unit.reconstruction.methods.multiview.true_maps import match_truly


def test_true_maps_of_late_images_differ_where_something_moves(
    trio: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    match_truly(monkeypatch, Dataset(trio))
    study = prepared(trio, instants=2)
    assert study.steps == 1 + 2 * 2
    result = study.compare(LATE)
    assert (result.cameras, result.instants) == (("left", "middle", "right"), 2)
    assert result.offsets_ms == {"left": 33, "middle": 0, "right": 66}
    instants = [int(row["instant"]) for row in result.per_instant]
    command = f"--instants {instants[0]},{instants[1]} --width 160 --quick --depth --condition left=33"
    assert command in result.commands["offset"]
    for kind in ("mover", "static"):
        for measure in ("coverage", "within_1pct", "within_2pct", "within_5pct", "precision"):
            assert both(result, f"{kind}_{measure}") == (1, 1), measure
    consistency, recall, points = (both(result, f"mover_{of}") for of in ("consistency", "recall", "points"))
    assert consistency[0] > 0.99
    assert 0.2 < consistency[1] < 0.8
    assert recall[0] > 0.95
    assert 0.2 < recall[1] < 0.8
    assert 1500 < points[0] < 1800
    assert 0.3 < points[1] / points[0] < 0.8
    assert both(result, "mover_photometric_error")[0] < 3
    assert both(result, "mover_photometric_error")[1] > 15
    for measure in ("consistency", "recall", "points"):
        synced, offset = both(result, f"static_{measure}")
        assert synced == offset > 0.3
    assert both(result, "static_photometric_error")[1] < 3
    row = result.per_instant[0]
    assert [round(row[f"offset_{camera}_ms"]) for camera in result.cameras] == [33, 0, 67]
    assert row["mover_pixels"] == int(study.shots.moving("middle", instants[0]).sum())
    facts = result.facts
    assert (facts.reference, facts.tolerance_m, facts.width_px, facts.clouds) == ("middle", 0.01, 160, None)
    assert result.pictures == ()


def test_pictures_and_clouds_show_the_instant_with_the_most_motion(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    match_truly(monkeypatch, Dataset(trio))
    study = prepared(trio, instants=1)
    result = study.compare(Condition.parse("left=33"), tmp_path)
    assert [picture.key.removeprefix("multiview_") for picture in result.pictures] == [
        "depth",
        "movers",
        "turntable",
        "colmap",
    ]
    drawn = {
        picture.key: [np.asarray(cv2.imread(str(tmp_path / of))) for of in (picture.synced, picture.offset)]
        for picture in result.pictures
    }
    assert all(image.std() > 5 for images in drawn.values() for image in images)
    first, last = drawn["multiview_depth"]
    assert np.array_equal(first, last)
    first, last = drawn["multiview_turntable"]
    assert not np.array_equal(first, last)
    first, last = drawn["multiview_colmap"]
    assert not np.array_equal(first, last)
    clouds = result.facts.clouds
    assert clouds is not None
    assert (clouds.instant, clouds.centre) == (result.per_instant[0]["instant"], (0.0, 0.03, 0.0))
    assert clouds.focal == pytest.approx(300 / 320, rel=0.01)
    assert clouds.rotation == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    # The middle of the board that jumps.
    assert clouds.pivot[2] == pytest.approx(2.2, abs=0.01)
    assert clouds.synced is not None
    assert len(read_ply(tmp_path / clouds.synced).points) > 10_000
    assert study.files(result) == {"the cloud of one instant in both": [clouds.synced, clouds.offset]}
    assert study.view(result, {}, tmp_path)["cloud"]["reference"] == "middle"
    words = study.placeholders(result)
    assert (words["reference"], words["width"], words["near"]) == ("middle", "160", " to within 1\u202fcm")
    assert words["matcher"] == "our own plane sweep, not by COLMAP"
    by_colmap = msgspec.structs.replace(result.facts, matcher="patchmatch", tolerance_m=None, clouds=None)
    other = msgspec.structs.replace(result, facts=by_colmap)
    assert study.placeholders(other)["near"] == ""
    assert study.placeholders(other)["matcher"] == "COLMAP's PatchMatch on a GPU"
    assert study.files(other) == {}
    assert study.view(other, {}, tmp_path) == {"cloud": None}

"""People in files: what other programs read is what was located."""

import base64
import json
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from reconstruction.methods.people.formats import c3d, gltf, trc
from reconstruction.methods.people.people_files import smoothed
from reconstruction.methods.people.people_run import UNSURE, unsure_joints
from reconstruction.methods.people.skeletons import Skeleton

SKELETON = Skeleton(("hip", "knee", "toe"), ((0, 1),))
TIMES_S = np.arange(5) / 50
POSITIONS = np.random.default_rng(3).uniform(-1, 1, (5, 3, 3))
POSITIONS[2, 1] = np.nan


def test_a_trc_has_its_rate_unit_and_gaps(tmp_path: Path) -> None:
    trc.write(tmp_path / "one.trc", TIMES_S, SKELETON, [POSITIONS], "m")
    lines = (tmp_path / "one.trc").read_text().split("\n")
    assert lines[2].split("\t")[:5] == ["50", "50", "5", "3", "m"]
    assert lines[3].split("\t")[2::3][:3] == ["hip", "knee", "toe"]
    rows = [line.split("\t") for line in lines[6:] if line]
    assert [row[:2] for row in rows][-1] == ["5", "0.080000"]
    assert rows[2][5:8] == ["", "", ""]
    assert float(rows[4][10]) == pytest.approx(POSITIONS[4, 2, 2], abs=1e-6)


def test_a_c3d_has_positions_and_gaps(tmp_path: Path) -> None:
    c3d.write(tmp_path / "one.c3d", TIMES_S, SKELETON, [POSITIONS], "m")
    read = ezc3d.c3d(str(tmp_path / "one.c3d"))
    parameters = read["parameters"]["POINT"]
    assert parameters["LABELS"]["value"] == list(SKELETON.joints)
    assert parameters["UNITS"]["value"] == ["m"]
    assert parameters["RATE"]["value"].tolist() == [50]
    known = np.isfinite(POSITIONS[..., 0])
    read_back = read["data"]["points"][:3].transpose(2, 1, 0)
    assert read_back[known] == pytest.approx(POSITIONS[known], abs=1e-6)
    residuals = read["data"]["meta_points"]["residuals"][0].T
    assert residuals[2, 1] == -1
    assert residuals[0].tolist() == [0, 0, 0]


def test_a_gltf_moves_each_joint_along_its_positions(tmp_path: Path) -> None:
    gltf.write(tmp_path / "one.gltf", TIMES_S, SKELETON, [POSITIONS], "m")
    document = json.loads((tmp_path / "one.gltf").read_text())
    data = base64.b64decode(document["buffers"][0]["uri"].partition(",")[2])
    (animation,) = document["animations"]
    names = [document["nodes"][one["target"]["node"]]["name"] for one in animation["channels"]]
    assert names == ["person1_hip", "person1_knee", "person1_toe"]
    accessor = document["accessors"][animation["samplers"][2]["output"]]
    view = document["bufferViews"][accessor["bufferView"]]
    values = np.frombuffer(data, "<f4", 15, view["byteOffset"]).reshape(5, 3)
    assert values == pytest.approx(POSITIONS[:, 2], abs=1e-6)
    assert document["skins"][0]["joints"] == [0, 1, 2]


def test_a_gltf_leaves_out_who_is_never_known(tmp_path: Path) -> None:
    nobody, apart = np.full((5, 3, 3), np.nan), POSITIONS.copy()
    apart[:3, 0] = apart[3:, 1] = np.nan
    gltf.write(tmp_path / "one.gltf", TIMES_S, SKELETON, [nobody, apart], "m")
    text = (tmp_path / "one.gltf").read_text()
    assert "NaN" not in text
    assert {node["name"].partition("_")[0] for node in json.loads(text)["nodes"]} == {"person2"}
    gltf.write(tmp_path / "none.gltf", TIMES_S, SKELETON, [nobody], "m")
    assert "animations" not in json.loads((tmp_path / "none.gltf").read_text())


def test_a_joint_is_unsure_by_its_error_and_the_size_of_its_person() -> None:
    positions = np.array([[[0.0, 0, 0], [0, 2, 0], [0, 1, 0], [np.nan] * 3]])
    error = np.array([[0.01, 2.1 * UNSURE, 1.9 * UNSURE, np.nan]])
    assert unsure_joints(positions, error).tolist() == [[False, True, False, False]]
    assert not unsure_joints(np.full((1, 2, 3), np.nan), np.full((1, 2), np.nan)).any()


def test_smoothing_keeps_a_slow_motion_and_removes_a_fast_one() -> None:
    times = np.arange(200) / 100
    slow = np.sin(2 * np.pi * times)[:, None, None] * np.ones(3)
    shaken = slow + 0.3 * np.sin(2 * np.pi * 30 * times)[:, None, None]
    assert np.abs(smoothed(shaken, 100, 6) - slow)[10:-10].max() < 0.02
    gap = shaken.copy()
    gap[90:95] = np.nan
    assert np.isnan(smoothed(gap, 100, 6)[90:95]).all()
    assert np.isfinite(smoothed(gap, 100, 6)[:90]).all()

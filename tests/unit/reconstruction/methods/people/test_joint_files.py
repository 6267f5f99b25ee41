"""Joints of other programs, read into the frames of a session's cameras."""

import json
import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.methods.people.joint_files import read_keypoints
from reconstruction.scene.dataset import Dataset
from tests.project import JUMPER

CAMERAS = ("cam00", "cam01")


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return Dataset.open(JUMPER)


def openpose(folder: Path, first: int = 0, frames: int = 5) -> None:
    """Write frames with two people of OpenPose's BODY_25."""
    folder.mkdir(parents=True)
    for k in range(frames):
        people = [[[10.0 * k + joint, 5.0 * person, 0.9] for joint in range(25)] for person in range(2)]
        keypoints = [{"person_id": [-1], "pose_keypoints_2d": np.ravel(one).tolist()} for one in people]
        content = json.dumps({"version": 1.3, "people": keypoints})
        (folder / f"film_{k + first:012d}_keypoints.json").write_text(content)


@pytest.mark.parametrize("first", [0, 1])
def test_openpose_json_a_folder_each(tmp_path: Path, dataset: Dataset, first: int) -> None:
    for camera in CAMERAS:
        openpose(tmp_path / f"{camera}_json", first)
    found = read_keypoints(tmp_path, dataset, CAMERAS)
    assert found.skeleton.joints[8] == "CHip"
    assert "cam01: cam01_json" in found.source
    assert found.cameras["cam01"][3].pixels[1, 4].tolist() == pytest.approx([34, 5])


def deeplabcut(*, individual: bool = False) -> str:
    """Return a table of DeepLabCut: a nose that moves, and a tail that nobody sees."""
    heads = {"scorer": ["net"] * 6}
    if individual:
        heads["individuals"] = ["mouse1"] * 6
    heads |= {"bodyparts": ["nose"] * 3 + ["tail"] * 3, "coords": ["x", "y", "likelihood"] * 2}
    rows = [",".join([name, *values]) for name, values in heads.items()]
    return "\n".join([*rows, *(f"{k},{k}.5,2,0.9,,,0.01" for k in range(5))]) + "\n"


@pytest.mark.parametrize("individual", [False, True])
def test_deeplabcut_csv_a_file_each(tmp_path: Path, dataset: Dataset, individual: bool) -> None:
    for camera in CAMERAS:
        (tmp_path / f"{camera}DLC_resnet50.csv").write_text(deeplabcut(individual=individual))
    found = read_keypoints(tmp_path, dataset, CAMERAS)
    frame = found.cameras["cam00"][4]
    assert found.skeleton.joints == ("nose", "tail")
    assert frame.pixels[0, 0].tolist() == [4.5, 2.0]
    assert frame.confidence[0].tolist() == [0.9, 0.0]


def test_deeplabcut_h5_a_file_each(tmp_path: Path, dataset: Dataset) -> None:
    columns = [("net", joint, axis) for joint in ("nose", "tail") for axis in ("x", "y", "likelihood")]
    for camera in CAMERAS:
        with h5py.File(tmp_path / f"{camera}DLC_resnet50.h5", "w") as file:
            group = file.create_group("df_with_missing")
            group.attrs["non_index_axes"] = np.bytes_(pickle.dumps([(1, columns)], 0))
            kinds = [("index", "<i8"), ("values_block_0", "<f8", (6,))]
            rows = [(k, (k, k + 0.5, 0.9, np.nan, np.nan, 0.01)) for k in range(5)]
            group["table"] = np.array(rows, kinds)
    found = read_keypoints(tmp_path, dataset, CAMERAS)
    frame = found.cameras["cam01"][4]
    assert found.skeleton.joints == ("nose", "tail")
    assert frame.pixels[0, 0].tolist() == [4.0, 4.5]
    assert frame.confidence[0].tolist() == [0.9, 0.0]


def test_an_h5_that_could_run_code_is_refused(tmp_path: Path, dataset: Dataset) -> None:
    for camera in CAMERAS:
        with h5py.File(tmp_path / f"{camera}.h5", "w") as file:
            group = file.create_group("df_with_missing")
            group.attrs["non_index_axes"] = np.bytes_(pickle.dumps([(1, print)], 0))
            group["table"] = np.zeros(3, [("index", "<i8"), ("values_block_0", "<f8", (6,))])
    with pytest.raises(BadInputError, match=r"is broken: it names \w+\.print"):
        read_keypoints(tmp_path, dataset, CAMERAS)


def test_sleap_analysis_a_file_each(tmp_path: Path, dataset: Dataset) -> None:
    for camera in CAMERAS:
        with h5py.File(tmp_path / f"{camera}.analysis.h5", "w") as file:
            file["tracks"] = np.arange(2 * 2 * 3 * 5, dtype=float).reshape(2, 2, 3, 5)
            file["node_names"], file["track_names"] = [b"a", b"b", b"c"], [b"one", b"two"]
            file["edge_inds"] = [[0, 1], [1, 2]]
    found = read_keypoints(tmp_path, dataset, CAMERAS)
    assert found.skeleton.bones == ((0, 1), (1, 2))
    frame = found.cameras["cam00"][2]
    assert frame.names == ("one", "two")
    assert frame.pixels[1, 2].tolist() == [42.0, 57.0]


@pytest.mark.parametrize(
    ("name", "said"),
    [("cam00.csv", "no joints of one camera in a format"), ("cam00.h5", "not a readable H5")],
)
def test_a_broken_file_is_named(tmp_path: Path, dataset: Dataset, name: str, said: str) -> None:
    for camera in CAMERAS:
        (tmp_path / name.replace("cam00", camera)).write_text("a,b\n1,2\n")
    with pytest.raises(BadInputError, match=said) as raised:
        read_keypoints(tmp_path, dataset, CAMERAS)
    assert name in raised.value.what


@pytest.mark.parametrize(("joints", "bone"), [(3, [1, 2]), (2, [1, 3])])
def test_joints_that_their_names_do_not_fit_are_refused(
    tmp_path: Path, dataset: Dataset, joints: int, bone: list[int]
) -> None:
    annotations = {
        "categories": [{"keypoints": [f"j{k}" for k in range(joints)], "skeleton": [bone]}],
        "images": [{"id": k, "file_name": f"{k}.jpg"} for k in range(5)],
        "annotations": [{"image_id": k, "keypoints": [1, 2, 1, 3, 4, 1]} for k in range(5)],
    }
    for camera in CAMERAS:
        (tmp_path / f"{camera}.json").write_text(json.dumps(annotations))
    with pytest.raises(BadInputError, match=f"joints other than the {joints} that it names"):
        read_keypoints(tmp_path, dataset, CAMERAS)


def test_files_that_fit_no_camera_are_refused(tmp_path: Path, dataset: Dataset) -> None:
    (tmp_path / "left.csv").write_text(deeplabcut())
    with pytest.raises(BadInputError, match=r"left\.csv.* of 0 of the cameras cam00, cam01"):
        read_keypoints(tmp_path, dataset, CAMERAS)


def test_two_files_of_one_camera_are_refused(tmp_path: Path, dataset: Dataset) -> None:
    for name in ("cam00_a.csv", "cam00_b.csv", "cam01.csv"):
        (tmp_path / name).write_text(deeplabcut())
    with pytest.raises(BadInputError, match="both of the camera cam00"):
        read_keypoints(tmp_path, dataset, CAMERAS)


def test_more_frames_than_the_session_has_are_refused(tmp_path: Path, dataset: Dataset) -> None:
    for camera in CAMERAS:
        openpose(tmp_path / camera, frames=9)
    with pytest.raises(BadInputError, match="has 9 frames, numbered 0 to 8, but the session has 5 images"):
        read_keypoints(tmp_path, dataset, CAMERAS)

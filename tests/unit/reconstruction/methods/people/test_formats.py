"""Joints as other programs write them, read by the first format that knows the file."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.methods.people import joint_formats
from reconstruction.methods.people.joint_files import read_keypoints
from reconstruction.methods.people.joint_formats import READERS, JointWriter, load_readers, load_writers
from reconstruction.methods.people.people_files import write_formats
from reconstruction.methods.people.skeletons import Skeleton
from reconstruction.scene.dataset import Dataset
from tests.project import JUMPER
from tests.unit.packaging.cut_tree import ENTRIES

CAMERAS = ("cam00", "cam01")
POINTS = [[10.0 * joint, 5.0] for joint in range(17)]
SCORES = [0.9] * 17
FLAT = np.column_stack([POINTS, SCORES]).ravel().tolist()


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return Dataset.open(JUMPER)


def moved(values: list[float], frame: int) -> list[float]:
    """Return x, y and score of joints, one pixel further right in each frame."""
    return (np.reshape(values, (-1, 3)) + np.array([frame, 0, 0])).ravel().tolist()


def instances(frame: int) -> list[dict[str, Any]]:
    points = [[x + frame, y] for x, y in POINTS]
    return [{"keypoints": points, "keypoint_scores": SCORES, "bbox": [[0, 0, 9, 9]], "bbox_score": 0.8}]


def coco_results(folder: Path, camera: str) -> None:
    """https://cocodataset.org, results of keypoints: a list, an entry a person, in any order."""
    entries = [
        {"image_id": k, "category_id": 1, "keypoints": moved(FLAT, k), "score": 0.9}
        for k in reversed(range(5))
    ]
    (folder / f"{camera}.json").write_text(json.dumps(entries))


def alphapose(folder: Path, camera: str) -> None:
    """AlphaPose, doc/output.md: as COCO's results, with the images' names."""
    entries = [
        {"image_id": f"frame{k}.jpg", "category_id": 1, "keypoints": moved(FLAT, k), "score": 2.5}
        for k in range(5)
    ]
    (folder / camera).mkdir()
    (folder / camera / "alphapose-results.json").write_text(json.dumps(entries))


def coco_annotations(folder: Path, camera: str) -> None:
    """https://cocodataset.org, format of data: images, annotations and categories."""
    content = {
        "images": [{"id": 50 - k, "file_name": f"{camera}/{k:06}.png"} for k in range(5)],
        "annotations": [
            {"id": k, "image_id": 50 - k, "category_id": 1, "keypoints": moved(FLAT, k)} for k in range(5)
        ],
        "categories": [
            {"id": 1, "name": "rat", "keypoints": [f"joint{k}" for k in range(17)], "skeleton": [[1, 2]]}
        ],
    }
    (folder / f"{camera}_keypoints.json").write_text(json.dumps(content))


def mmpose_film(folder: Path, camera: str) -> None:
    """MMPose's inferencer of a film, `pred_out_dir`: frames from 0."""
    frames = [{"frame_id": k, "instances": instances(k)} for k in range(5)]
    (folder / f"{camera}.json").write_text(json.dumps(frames))


def mmpose_demo(folder: Path, camera: str) -> None:
    """MMPose's demos with `--save-predictions`: frames from 1."""
    frames = [{"frame_id": k + 1, "instances": instances(k)} for k in range(5)]
    content = {"meta_info": {"dataset_name": "coco"}, "instance_info": frames}
    (folder / f"results_{camera}.json").write_text(json.dumps(content))


def mmpose_images(folder: Path, camera: str) -> None:
    """MMPose's inferencer of a folder of images: a file each."""
    (folder / camera).mkdir()
    for k in range(5):
        (folder / camera / f"{k:06}.json").write_text(json.dumps(instances(k)))


def openpose_beside_each_other(folder: Path, camera: str) -> None:
    """OpenPose's files of all cameras in one folder."""
    for k in range(5):
        content = {"version": 1.3, "people": [{"pose_keypoints_2d": moved(FLAT, k)}]}
        (folder / f"{camera}_{k:012d}_keypoints.json").write_text(json.dumps(content))


@pytest.mark.parametrize(
    "write",
    [
        *(coco_results, alphapose, coco_annotations),
        *(mmpose_film, mmpose_demo, mmpose_images, openpose_beside_each_other),
    ],
)
def test_json_of_other_programs(tmp_path: Path, dataset: Dataset, write: Callable[[Path, str], None]) -> None:
    for camera in CAMERAS:
        write(tmp_path, camera)
    found = read_keypoints(tmp_path, dataset, CAMERAS)
    assert len(found.skeleton.joints) == 17
    for camera in CAMERAS:
        for k in range(5):
            frame = found.cameras[camera][k]
            assert frame.pixels[0, 3].tolist() == pytest.approx([30 + k, 5])
            assert frame.confidence[0, 3] == pytest.approx(0.9)


def test_categories_name_the_joints_and_bones(tmp_path: Path, dataset: Dataset) -> None:
    for camera in CAMERAS:
        coco_annotations(tmp_path, camera)
    skeleton = read_keypoints(tmp_path, dataset, CAMERAS).skeleton
    assert (skeleton.joints[1], skeleton.bones) == ("joint1", ((0, 1),))


NAME = "mediapipe_2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy"


@pytest.mark.parametrize("order", ["C", "F"])
def test_freemocap_has_all_cameras_in_one_array(tmp_path: Path, dataset: Dataset, order: Any) -> None:
    array = np.arange(2 * 5 * 553 * 3, dtype=float).reshape(2, 5, 553, 3)
    array[1, 2, 4] = np.nan
    np.save(tmp_path / NAME, np.array(array, order=order))
    np.save(tmp_path / "mediapipe_3dData_numFrames_numTrackedPoints_spatialXYZ.npy", np.zeros((5, 553, 3)))
    found = read_keypoints(tmp_path, dataset, CAMERAS)
    assert found.skeleton.joints[0] == "nose"
    frame = found.cameras["cam01"][2]
    assert frame.pixels[0, 32].tolist() == pytest.approx(array[1, 2, 32, :2].tolist())
    assert frame.confidence[0, [3, 4]].tolist() == [1, 0]


def test_an_array_of_other_cameras_is_refused(tmp_path: Path, dataset: Dataset) -> None:
    np.save(tmp_path / NAME, np.ones((3, 5, 553, 3)))
    with pytest.raises(BadInputError, match="has 3 cameras, not cam00, cam01"):
        read_keypoints(tmp_path, dataset, CAMERAS)


def test_an_array_that_claims_more_than_it_has_is_refused(tmp_path: Path, dataset: Dataset) -> None:
    np.save(tmp_path / NAME, np.ones((2, 5, 553, 3)))
    data = (tmp_path / NAME).read_bytes()
    for claim, said in (
        (b"(2,9999,99, 3)", "is broken: cannot reshape"),
        (b"(2, 9999, 553,", "not an array"),
    ):
        (tmp_path / NAME).write_bytes(data.replace(b"(2, 5, 553, 3)", claim))
        with pytest.raises(BadInputError, match=said):
            read_keypoints(tmp_path, dataset, CAMERAS)


@pytest.mark.parametrize("name", ENTRIES[READERS])
def test_without_a_format_the_others_are_read(
    tmp_path: Path, dataset: Dataset, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    left = {key: reader for key, reader in load_readers().items() if key != name}
    monkeypatch.setattr("reconstruction.methods.people.joint_files.load_readers", lambda: left)
    write = mmpose_film if name != "coco" else openpose_beside_each_other
    for camera in CAMERAS:
        write(tmp_path, camera)
    assert len(read_keypoints(tmp_path, dataset, CAMERAS).cameras) == 2


def test_a_package_adds_a_format_of_people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(path: Path, times_s: Any, skeleton: Skeleton, people: Any, unit: str) -> None:
        path.write_text(f"{len(times_s)} times, {len(people)} people in {unit}")

    writers = {**load_writers(), "xyz": JointWriter(write=write, one_person=False)}
    del writers["trc"]
    monkeypatch.setattr("reconstruction.methods.people.people_files.load_writers", lambda: writers)
    people = [np.zeros((5, 2, 3)), np.ones((5, 2, 3))]
    assert write_formats(tmp_path, np.arange(5) / 50, Skeleton(("a", "b"), ()), people, "m", None) == []
    assert (tmp_path / "people.xyz").read_text() == "5 times, 2 people in m"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c3d", "people.gltf", "people.xyz"]
    assert sorted(path.name for path in (tmp_path / "c3d").iterdir()) == ["person1.c3d", "person2.c3d"]


def test_no_module_imports_a_format() -> None:
    room = Path(joint_formats.__file__).parent
    assert [path.name for path in room.glob("*.py") if "people.formats" in path.read_text()] == []

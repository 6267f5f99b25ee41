"""Videos and images are found equally deep, and what is not used is named."""

from collections.abc import Callable
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.found import describe_unused, find_calibration
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.recording import import_found
from capture_app.session.importing.importer import takes_in
from capture_app.session.importing.recording_sources import folders_below
from tests.imported import import_one
from tests.unit.companions.importing.numbered_video import write_video
from tests.unit.session.conftest import jpeg


def images(folder: Path, count: int = 3) -> None:
    folder.mkdir(parents=True)
    for number in range(count):
        (folder / f"{number}.jpg").write_bytes(jpeg(number))


def found(folder: Path, *sources: str) -> tuple[list[list[str]], str]:
    said: list[str] = []
    options = ImportOptions(fps=30, align="none")
    sessions = import_found(sources or [str(folder)], folder.parent / "out", "s", options, talk=said.append)
    return [[camera.name for camera in one.manifest.cameras] for one in sessions], "\n".join(said)


@pytest.mark.parametrize("inner", ["{}", "{}/data", "rig/{}/images/full", "{}/a/b/c/d/e"])
def test_images_are_found_deep(tmp_path: Path, inner: str) -> None:
    for camera in ("cam0", "cam1"):
        images(tmp_path / "rec" / inner.format(camera))
    assert found(tmp_path / "rec")[0] == [["cam0", "cam1"]]


def test_the_images_of_a_camera_that_is_named_lie_deeper(tmp_path: Path) -> None:
    for camera in ("cam0", "cam1"):
        images(tmp_path / "rec" / camera / "data")
    cameras = [f"{side}={tmp_path / 'rec' / camera}" for side, camera in (("l", "cam0"), ("r", "cam1"))]
    assert found(tmp_path / "rec", *cameras)[0] == [["l", "r"]]
    images(tmp_path / "rec" / "cam0" / "depth")
    with pytest.raises(BadInputError, match="cam0 has several folders of images or videos: data, depth"):
        import_one(cameras, tmp_path, "again", ImportOptions(fps=30))


def test_videos_five_deep_beside_images_are_the_cameras(tmp_path: Path) -> None:
    images(tmp_path / "rec" / "stills")
    for camera in ("a", "b"):
        write_video(tmp_path / "rec" / "1/2/3/4/5" / f"{camera}.mp4", (0, 33_000, 66_000))
    cameras, said = found(tmp_path / "rec")
    assert cameras == [["a", "b"]]
    assert "not used: stills: 3 .jpg" in said


def test_kinds_of_images_are_not_takes(tmp_path: Path) -> None:
    for kind in ("depth", "rgb"):
        for camera in ("cam0", "cam1"):
            images(tmp_path / "rec" / camera / kind)
    with pytest.raises(BadInputError, match=r"4 folders of images, of several takes or kinds: cam0.depth"):
        takes_in(tmp_path / "rec")


def test_smaller_copies_of_images_are_no_camera(tmp_path: Path) -> None:
    for place in ("images", "images_4", "images_8"):
        images(tmp_path / "rec" / place)
    cameras, said = found(tmp_path / "rec")
    assert cameras == [["images"]]
    assert "not used: images_4: 3 .jpg, images_8: 3 .jpg" in said
    (tmp_path / "rec" / "images").rename(tmp_path / "rec" / "images_2")
    takes, _ = takes_in(tmp_path / "rec")
    assert [label for label, *_ in takes[""]] == ["images_2", "images_4", "images_8"]


def test_what_is_not_used_is_one_line(tmp_path: Path, make_images: Callable[..., Path]) -> None:
    folder = make_images("left", ["0.jpg"]).parent
    for name in ("sensor.txt", "notes.txt", ".DS_Store", *(f"{n}.dat" for n in range(4))):
        (folder / name).write_text("x")
    said = describe_unused(folder, [folder / "left"])
    assert said == ["not used: notes.txt, sensor.txt, 4 .dat"]
    assert describe_unused(folder / "left", [folder / "left"]) == []


def test_a_calibration_that_nobody_reads_is_named_with_what_to_do(tmp_path: Path) -> None:
    for camera in ("Camera_B1", "Camera_B2"):
        images(tmp_path / "CoreView" / camera)
    (tmp_path / "CoreView" / "annots.npy").touch()
    _, said = found(tmp_path / "CoreView")
    (line,) = (line for line in said.splitlines() if line.startswith("calibration: "))
    assert line.startswith("calibration: annots.npy is of ZJU-MoCap (cams), which is not read")
    assert "or calibrate the session" in line


@pytest.mark.parametrize(
    ("cameras", "file", "given"),
    [
        ("MH_01/mav0/cam0/data MH_01/mav0/cam1/data", "MH_01/mav0/cam0/sensor.yaml", "MH_01"),
        ("mav0/cam0/data mav0/cam1/data", "mav0/cam0/sensor.yaml", "mav0"),
        ("day/drive/image_02/data day/drive/image_03/data", "day/calib_cam_to_cam.txt", "day/drive"),
        ("day/drive/image_02/data day/drive/image_03/data", "day/calib_cam_to_cam.txt", "day"),
        ("00/image_0 00/image_1", "00/calib.txt", "00"),
        ("171204/hdImgs/00_00 171204/hdImgs/00_01", "171204/calibration_171204.json", "171204"),
        ("rec/cam0 rec/cam1", "rec/camera_parameters/rot_trans_c0.dat", "rec"),
        ("fern/cam00 fern/cam01", "fern/poses_bounds.npy", "fern"),
        ("rec/cam1 rec/cam2", "rec/camera_matrix/stereo_params.pickle", "rec"),
    ],
)
def test_calibrations_of_data_sets_are_found_where_these_have_them(
    cameras: str, file: str, given: str, tmp_path: Path
) -> None:
    for camera in cameras.split():
        images(tmp_path / camera)
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_text("no numbers")
    _, said = found(tmp_path / given)
    beside, used = find_calibration(tmp_path / given)
    assert beside is not None
    assert f"calibration: {beside} is not taken: " in said
    assert Path(file).name not in said.partition("calibration: ")[0], "not used, and tried"
    assert used


def test_both_files_of_a_calibration_beside_are_used(tmp_path: Path) -> None:
    for camera in ("01", "02"):
        write_video(tmp_path / "rec" / f"{camera}.mp4", (0, 33_000, 66_000))
    (tmp_path / "rec" / "calibration").mkdir()
    for name in ("intri.yml", "extri.yml"):
        (tmp_path / "rec" / "calibration" / name).write_text('%YAML:1.0\n---\nnames:\n  - "01"\n')
    _, said = found(tmp_path / "rec")
    assert "not used" not in said
    assert f"calibration: {tmp_path / 'rec' / 'calibration'} is not taken: " in said


def test_links_in_a_circle_end(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "again").symlink_to(tmp_path)
    (tmp_path / "a" / "itself").symlink_to(tmp_path / "a" / "itself")
    assert list(folders_below(tmp_path)) == [tmp_path, tmp_path / "a"]


def test_a_calibration_lies_beside_or_in_a_folder_that_says_so(tmp_path: Path) -> None:
    for folder in ("calibration", "photos"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "rig_config.json").touch()
    assert find_calibration(tmp_path / "photos")[0] == tmp_path / "photos/rig_config.json"
    assert find_calibration(tmp_path)[0] == tmp_path / "calibration/rig_config.json"
    (tmp_path / "calibration/cam0-camchain.yaml").touch()
    (tmp_path / "calibration/rig_config.json").unlink()
    assert find_calibration(tmp_path)[0] == tmp_path / "calibration/cam0-camchain.yaml"
    (tmp_path / "rig_config.json").touch()
    assert find_calibration(tmp_path)[0] == tmp_path / "rig_config.json"
    (tmp_path / "rig_config.json").unlink()
    (tmp_path / "calibration").rename(tmp_path / "pictures")
    assert find_calibration(tmp_path) == (None, [])

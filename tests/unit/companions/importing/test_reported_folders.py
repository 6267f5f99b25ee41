"""Folders as people described them in public reports, and what an import makes of each."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.clips import find_shoots
from tests.unit.companions.importing.numbered_video import imported, write_video
from tests.unit.session.conftest import jpeg


def clips(folder: Path, files: Sequence[str], count: int = 3) -> Path:
    for file in files:
        write_video(folder / file, [33_333 * n for n in range(count)])
    return folder


def takes(folder: Path) -> list[dict[str, str]]:
    shoots, _ = find_shoots(folder)
    return [{name: clip.path.name for name, clip in shoot.items()} for _, shoot in shoots]


def images(folder: Path, files: Sequence[str]) -> Path:
    for number, file in enumerate(files):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(jpeg(number))
    return folder


def test_serials_that_follow_a_videos_number(tmp_path: Path) -> None:
    """lambdaloop/anipose#97: cameras 10374 and 10376, named Video110374 and Video110376."""
    (take,) = takes(clips(tmp_path, ["Video110374.avi", "Video110376.avi"]))
    assert [*take.values()] == ["Video110374.avi", "Video110376.avi"]


def test_serials_with_dates_that_differ_by_seconds(tmp_path: Path) -> None:
    """lambdaloop/anipose#11: each camera's file is named by its own start."""
    of = {"18475996": "06", "18475997": "08", "19061101": "09"}
    names = [f"dal_liom_guid_{serial}_2020_02_13_20_25_{second}.mp4" for serial, second in of.items()]
    (take,) = takes(clips(tmp_path, names))
    assert [*take.values()] == names


def test_a_calibration_of_equal_names_is_no_take(tmp_path: Path) -> None:
    """lambdaloop/anipose#48: session1/calibration/calibration_anipose_cam_0.avi beside the videos."""
    files = [f"calibration/calibration_anipose_cam_{n}.avi" for n in range(3)]
    videos = [f"videos-raw/walk_cam_{n}.avi" for n in range(3)]
    (take,) = takes(clips(tmp_path, [*files, *videos]))
    assert [*take.values()] == [Path(video).name for video in videos]


def test_dates_in_the_names_of_two_trials(tmp_path: Path) -> None:
    """lambdaloop/anipose#1: cam0_calibrate_191029_151437.mp4, and trials of other times."""
    files = [f"cam{n}_walk_191029_{at}.mp4" for n in range(2) for at in ("160000", "161200")]
    folder = clips(tmp_path, [*files, *(f"calibration/cam{n}_calibrate_191029_151437.mp4" for n in range(2))])
    assert [[*take.values()] for take in takes(folder)] == [files[0::2], files[1::2]]


def test_unequal_counts_are_never_asked_about(tmp_path: Path) -> None:
    """MobileRoboticsSkoltech/OpenCamera-Sensors#68: 472 frames and 469, as the phones stopped apart."""
    clips(tmp_path / "in", ["one.mp4"], count=8)
    session, said = imported(clips(tmp_path / "in", ["two.mp4"], count=5))
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.unknown
    assert "--synchronized" not in said


def test_times_in_names_pair_cameras_that_dropped_others(tmp_path: Path) -> None:
    """Kitware/dive#1742: frame 5 of one camera is another instant than frame 5 of the other."""
    files = [
        f"{camera}/fl07_{camera}_20240407_1307{second}.206341_ir.jpg"
        for camera, seconds in {"C": (57, 58, 59), "L": (57, 59)}.items()
        for second in seconds
    ]
    session, _ = imported(images(tmp_path / "in", files), times="name")
    assert [(gone.camera, gone.instant) for gone in session.manifest.missing] == [("L", 1)]


@pytest.mark.parametrize("frames", [range(2), range(3), range(8, 12)])
def test_names_that_end_with_the_camera(tmp_path: Path, frames: range) -> None:
    """dicengine/dice#126: FRAME_CAMERA, of any number of digits; frames are not taken as cameras."""
    files = [f"Cal_{frame}_{camera}.jpg" for frame, camera in product(frames, (0, 1))]
    with pytest.raises(BadInputError, match=f"{len(files)} images, whose names tell no cameras apart"):
        imported(images(tmp_path / "in", files), fps=30.0)


def test_poses_of_an_unread_format_are_named(tmp_path: Path) -> None:
    """facebookresearch/Neural_3D_Video#5: cam00, cam13 and poses_bounds.npy for fewer cameras."""
    clips(tmp_path / "in", ["cam00.mp4", "cam01.mp4", "cam13.mp4"])
    (tmp_path / "in" / "poses_bounds.npy").write_bytes(b"\x93NUMPY")
    session, said = imported(tmp_path / "in")
    assert [camera.name for camera in session.manifest.cameras] == ["cam00", "cam01", "cam13"]
    assert "poses_bounds.npy" in said


def test_a_calibration_of_other_names_is_said_with_its_pairs(tmp_path: Path) -> None:
    """perfanalytics/pose2sim#51: cam_01 in the calibration is not the name of a video."""
    clips(tmp_path / "in", ["GX010042.mp4", "Canon.mp4"])
    lens = "size = [16, 12]\nmatrix = [[9, 0, 8], [0, 9, 6], [0, 0, 1]]\ndistortions = [0, 0, 0, 0]\n"
    cameras = (
        f'[cam_0{n}]\nname = "cam_0{n}"\n{lens}rotation = [0, 0, 0]\ntranslation = [{n}, 0, 0]\n'
        for n in (1, 2)
    )
    (tmp_path / "in" / "calibration.toml").write_text("".join(cameras))
    session, said = imported(tmp_path / "in")
    assert session.calibration() is None
    assert "calibration.toml is not taken: " in said
    assert "calibrates cam_01, cam_02" in said


def test_a_table_that_gives_no_times_is_named(tmp_path: Path) -> None:
    """JARVIS-MoCap/JARVIS-AcquisitionTool#10: metadata.csv lies in the folder of six cameras' videos."""
    clips(tmp_path / "in", [f"Camera_{letter}.avi" for letter in "ABCDEF"])
    (tmp_path / "in" / "metadata.csv").write_text("camera,serial\nA,19194005\nB,19194008\n")
    session, said = imported(tmp_path / "in")
    assert len(session.manifest.cameras) == 6
    assert "not used: metadata.csv" in said

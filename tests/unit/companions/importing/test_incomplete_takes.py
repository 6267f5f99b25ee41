"""Clips whose names differ by their camera's own label are one take, whatever else a folder lacks."""

from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.companions.importing.clips import find_shoots
from tests.unit.companions.importing.numbered_video import write_video

VARIANTS: dict[str, tuple[list[str], list[dict[str, str]]]] = {
    "missing at the end": (
        ["left/left_1.mp4", "left/left_2.mp4", "right/right_1.mp4"],
        [{"left": "left_1", "right": "right_1"}],
    ),
    "missing at the front": (
        ["left/left_1.mp4", "left/left_2.mp4", "right/right_2.mp4"],
        [{"left": "left_2", "right": "right_2"}],
    ),
    "missing in the middle": (
        ["a/a_x.mp4", "a/a_y.mp4", "a/a_z.mp4", "b/b_x.mp4", "b/b_z.mp4"],
        [{"a": "a_x", "b": "b_x"}, {"a": "a_z", "b": "b_z"}],
    ),
    "a label as suffix": (
        ["left/walk-left.mp4", "left/run-left.mp4", "right/run-right.mp4"],
        [{"left": "run-left", "right": "run-right"}],
    ),
    "a label in the middle": (
        ["top/s1_top_walk.mp4", "top/s1_top_run.mp4", "side/s1_side_walk.mp4"],
        [{"top": "s1_top_walk", "side": "s1_side_walk"}],
    ),
    "a folder as the only label": (
        ["left/walk.mp4", "left/run.mp4", "right/run.mp4"],
        [{"left": "run", "right": "run"}],
    ),
    "another word than the folder's": (
        ["cam1/walk_left.mp4", "cam1/run_left.mp4", "cam2/run_right.mp4"],
        [{"cam1": "run_left", "cam2": "run_right"}],
    ),
    "letter case": (
        ["Left/LEFT_1.mp4", "Left/LEFT_2.mp4", "Right/RIGHT_2.mp4"],
        [{"Left": "LEFT_2", "Right": "RIGHT_2"}],
    ),
    "numbers beside": (
        ["cam1/cam1_day2_3.mp4", "cam1/cam1_day2_4.mp4", "cam2/cam2_day2_4.mp4"],
        [{"cam1": "cam1_day2_4", "cam2": "cam2_day2_4"}],
    ),
    "counted by a program that labels": (
        ["cam1/cam1_0001.mp4", "cam1/cam1_0002.mp4", "cam2/cam2_0002.mp4"],
        [{"cam1": "cam1_0002", "cam2": "cam2_0002"}],
    ),
    "each camera lacks another": (
        ["a/a_1.mp4", "a/a_2.mp4", "b/b_1.mp4", "b/b_3.mp4", "c/c_2.mp4", "c/c_3.mp4"],
        [{"a": "a_1", "b": "b_1"}, {"a": "a_2", "c": "c_2"}, {"b": "b_3", "c": "c_3"}],
    ),
    "a folder of each take in each camera's": (
        ["a/take1/video.mp4", "a/take2/video.mp4", "b/take2/video.mp4"],
        [{"a": "video", "b": "video"}],
    ),
    "calibration in a folder of each camera": (
        ["a/x_a.mp4", "a/calibration_images/s_a.mp4", "a/calibration_images/s_a.mov", "b/x_b.mp4"],
        [{"a": "x_a", "b": "x_b"}],
    ),
    "two types of one name": (
        ["a/a_1.mp4", "a/a_2.mp4", "a/a_2.mov", "b/b_1.mp4", "b/b_2.mov"],
        [{"a": "a_1", "b": "b_1"}, {"a": "a_2", "b": "b_2"}],
    ),
    "one folder, missing at the end": (
        ["cam1_take1.mp4", "cam1_take2.mp4", "cam2_take1.mp4"],
        [{"cam1": "cam1_take1", "cam2": "cam2_take1"}],
    ),
    "one folder, names that ASCII has no letters for": (
        [f"trial{t}_{c}.mp4" for t in (1, 2) for c in ("يسار", "يمين")],
        [{c: f"trial{t}_{c}" for c in ("يسار", "يمين")} for t in (1, 2)],
    ),
    "one folder, three cameras": (
        [f"trial{t}_cam{c}.mp4" for t, c in ((1, 1), (1, 3), (2, 1), (2, 2), (2, 3))],
        [
            {"cam1": "trial1_cam1", "cam3": "trial1_cam3"},
            {"cam1": "trial2_cam1", "cam2": "trial2_cam2", "cam3": "trial2_cam3"},
        ],
    ),
    "one folder, a drawn copy of one camera": (
        ["cam0_kpts.mp4", "cam0_test.mp4", "cam1_test.mp4"],
        [{"cam0": "cam0_test", "cam1": "cam1_test"}],
    ),
}


def found(folder: Path, files: list[str]) -> tuple[list[dict[str, str]], list[str]]:
    for file in files:
        write_video(folder / file, (0, 33_000, 66_000))
    shoots, left_out = find_shoots(folder)
    return [{name: clip.path.stem for name, clip in clips.items()} for _, clips in shoots], left_out


@pytest.mark.parametrize("variant", VARIANTS)
def test_equal_names_but_for_the_label_are_one_take(tmp_path: Path, variant: str) -> None:
    files, takes = VARIANTS[variant]
    shoots, left_out = found(tmp_path, files)
    assert sorted(map(sorted, (shoot.items() for shoot in shoots))) == sorted(
        map(sorted, (take.items() for take in takes))
    )
    assert bool(left_out) == (sum(map(len, takes)) < len(files))


@pytest.mark.parametrize(
    "files",
    [
        ["a/IMG_0001.mp4", "b/IMG_0077.mp4", "c/IMG_0005.mp4", "c/IMG_0006.mp4"],
        ["a/C0017.mp4", "a/C0018.mp4", "b/C0017.mp4"],
        ["a/holiday.mp4", "b/cat.mp4", "c/x.mp4", "c/y.mp4"],
    ],
)
def test_names_that_no_label_tells_apart_are_no_take(tmp_path: Path, files: list[str]) -> None:
    shoots, _ = found(tmp_path, files)
    # Counters of one camera mean nothing for another's; equal ones are taken only for want of dates.
    assert all(len({*shoot.values()}) == 1 for shoot in shoots)


@pytest.mark.parametrize(
    ("clip", "copy"),
    [
        ("M4ROOT/CLIP/C0001.MP4", "M4ROOT/SUB/C0001S03.MP4"),
        ("GX010012.MP4", "GL010012.MP4"),
        ("VID_20260131_142530_00_001.mp4", "LRV_20260131_142530_01_001.mp4"),
        ("scene.mov", "Proxy/scene.mov"),
    ],
)
def test_small_copies_are_left_out_and_named(tmp_path: Path, clip: str, copy: str) -> None:
    shoots, notes = found(tmp_path, [f"{camera}/{path}" for camera in ("a", "b") for path in (clip, copy)])
    assert [[*shoot.values()] for shoot in shoots] == [[Path(clip).stem] * 2]
    assert [note.partition(":")[0] for note in notes] == [f"left out {camera}/{copy}" for camera in "ab"]


def test_equal_files_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found(tmp_path / "in", ["a.mp4", "b.mp4"])
    write_video(tmp_path / "in" / "c.mp4", (0, 33_000, 70_000))
    assert run(["sessions", "import", str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert said.count("are equal files") == 1
    assert f"{tmp_path / 'in' / 'a.mp4'} and {tmp_path / 'in' / 'b.mp4'} are equal files" in said


def test_folders_between_a_camera_and_its_clips_name_takes(tmp_path: Path) -> None:
    files = [f"{camera}/{take}/video.mp4" for camera in ("cam1", "cam2") for take in ("take1", "take2")]
    for file in files:
        write_video(tmp_path / file, (0, 33_000, 66_000))
    shoots, _ = find_shoots(tmp_path)
    assert [(take, {clip.path.parent.name for clip in clips.values()}) for take, clips in shoots] == [
        ("take1", {"take1"}),
        ("take2", {"take2"}),
    ]


def test_clips_of_one_name_are_called_like_their_folders(tmp_path: Path) -> None:
    for take, camera in (("walk", "🔴"), ("walk", "🔵"), ("run", "🔴"), ("run", "🔵")):
        write_video(tmp_path / take / camera / "video.mp4", (0, 33_000, 66_000))
    shoots, _ = find_shoots(tmp_path)
    assert [(take, [*clips]) for take, clips in shoots] == [("run", ["🔴", "🔵"]), ("walk", ["🔴", "🔵"])]

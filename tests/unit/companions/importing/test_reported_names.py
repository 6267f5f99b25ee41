"""Names of frames and of cameras as public reports have them, each with what went wrong elsewhere."""

from collections.abc import Callable
from pathlib import Path

import pytest

from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.format.camera_labels import pair_labels
from tests.imported import import_one

FRAMES: dict[str, Callable[[int], str]] = {
    # Kitware/dive#1742: a time with a fraction between a flight's name and the camera's kind.
    "a capture time": lambda i: f"fl07_C_20240407_1307{57 + i // 30:02d}.{206341 + 33000 * i:06d}_ir",
    # robot-learning-freiburg/MM-DistillNet#8: seconds, nanoseconds, and a sequence number.
    "seconds, nanoseconds, sequence": lambda i: f"0_1586873154_{433877998 + 33333333 * i}_{i}",
    # kadn/OpenSeqSLAM2.0#2: images taken out of a film at intervals of ten keep the film's numbers.
    "every tenth frame": lambda i: f"image-{10 * i + 1}",
    # dicengine/dice#126: numbers without leading zeros, sorted as text elsewhere.
    "no leading zeros": lambda i: f"cal_{i + 5}",
    # laxnpander/OpenREALM#21: a survey's names, with a mission's number that is not the frame's.
    "a mission and a counter": lambda i: f"DJI_0042_mission3_{i:04d}_RGB",
}
CAMERAS = {
    # perfanalytics/pose2sim#169: calibrations in the order of a folder, mixed with other cameras' videos.
    "folder order": (["cam10", "cam2", "cam1"], ["cam1", "cam2", "cam10"], ["cam1", "cam2", "cam10"]),
    # perfanalytics/pose2sim#51: numbered cam_01 and on, whatever the cameras are called.
    "numbered by place": (["cam_01", "cam_02"], ["M11139", "M11140"], []),
    # perfanalytics/pose2sim#120: three cameras of one make, and one that has no number.
    "one without a number": (
        ["osmo", "logi_3", "logi_2", "logi_1"],
        ["logi_1", "logi_2", "logi_3", "osmo"],
        ["logi_1", "logi_2", "logi_3", "osmo"],
    ),
    # talmolab/sleap-anipose#31: views named by place, in another order than the calibration's.
    "a name that begins another": (
        ["top", "sideL", "side", "back"],
        ["back", "side", "sideL", "top"],
        ["back", "side", "sideL", "top"],
    ),
    # perfanalytics/pose2sim#136: Caliscope's sections are cam_1, its videos port_1.
    "ports": (["cam_2", "cam_1"], ["port_1", "port_2"], ["cam_1", "cam_2"]),
}


@pytest.mark.parametrize("named", FRAMES.values(), ids=FRAMES)
def test_a_frame_that_one_camera_lacks_is_missing_there(
    named: Callable[[int], str], tmp_path: Path, make_images: Callable[..., Path]
) -> None:
    folder = make_images("a", [f"{named(i)}.png" for i in range(8)]).parent
    make_images("b", [f"{named(i)}.png" for i in range(8) if i != 3])
    session = import_one([str(folder)], tmp_path, "s", ImportOptions(fps=30))
    (missing,) = [(gone.camera, gone.instant) for gone in session.manifest.missing if gone.camera == "b"]
    a = [image.instant for image in session.manifest.images if image.camera == "a"]
    assert missing == ("b", a[3])


@pytest.mark.parametrize(("labels", "cameras", "pairs"), CAMERAS.values(), ids=CAMERAS)
def test_a_label_is_of_the_camera_that_it_names(
    labels: list[str], cameras: list[str], pairs: list[str]
) -> None:
    assert pair_labels(labels, cameras) == dict(zip(cameras, pairs, strict=False))

"""Labels of other files belong to the cameras that they name, whatever else looks like them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.common.errors import BadInputError
from capture_app.session.format.camera_labels import describe_pairs, pair_labels, require_camera


@pytest.mark.parametrize(
    ("labels", "cameras", "pairs"),
    [
        (["logi_1", "osmo_1", "logi_2", "osmo_2"], ["logi_1", "logi_2"], ["logi_1", "logi_2"]),
        (["osmo_1", "osmo_2"], ["logi_1", "logi_2"], []),
        (["osmo_1", "logi_2"], ["logi_1", "logi_2"], ["", "logi_2"]),
        (["0", "1", "2"], ["cam_0", "cam_1"], ["0", "1"]),
        (["port_01", "port_00"], ["cam_0", "cam_1"], ["port_00", "port_01"]),
        (["RIGHT", "left"], ["left", "right"], ["left", "RIGHT"]),
        (["A", "a"], ["a", "A"], ["a", "A"]),
        (["Go Pro 1", "Go Pro 2"], ["go-pro_01", "go-pro_02"], ["Go Pro 1", "Go Pro 2"]),
        (["1", "2"], ["gopro_1", "gopro_2"], ["1", "2"]),
        (["cam1", "cam2"], ["gopro_1", "gopro_2"], ["cam1", "cam2"]),
        (["1", "2", "3"], ["gopro_1", "gopro_2"], []),
        (["0", "1"], ["gopro_1", "gopro_2"], []),
        (["0"], ["left0", "right0"], []),
        (["1"], ["left1"], ["1"]),
        (["cam01", "cam_1"], ["cam1"], []),
    ],
)
def test_labels_are_paired_by_whole_names(labels: list[str], cameras: list[str], pairs: list[str]) -> None:
    expected = {camera: label for camera, label in zip(cameras, pairs, strict=False) if label}
    assert pair_labels(labels, cameras) == expected


@pytest.mark.parametrize(
    ("text", "camera"),
    [
        ("Bo\u0308hm", "Bohm"),
        ("BÖHM", "Bohm"),
        ("Bohm", "Bohm-2"),
        ("bohm", "Bohm-2"),
        ("cam0", "cam0"),
        ("カメラ左", "cam0"),
        ("Left_1", "left1"),
        ("LEFT1", "left1-2"),
        ("böhm2", ""),
    ],
)
def test_a_camera_is_known_by_its_label_and_then_by_its_name(text: str, camera: str) -> None:
    cameras = {"Bohm": "Böhm", "Bohm-2": "Bohm", "cam0": "カメラ左", "left1": "Left 1", "left1-2": "left1"}
    if camera:
        assert require_camera(text, cameras, "--reference") == camera
        return
    with pytest.raises(BadInputError, match=f"--reference names {text}, which the recording lacks"):
        require_camera(text, cameras, "--reference")


NAMES = st.lists(st.from_regex(r"\\A[ab]?_?[0-2]{0,2}\\Z"), min_size=1, max_size=5, unique=True)


@given(NAMES, NAMES)
def test_pairs_are_one_to_one_and_equal_names_are_paired(labels: list[str], cameras: list[str]) -> None:
    pairs = pair_labels(labels, cameras)
    assert len(set(pairs.values())) == len(pairs)
    assert all(pairs.get(name) == name for name in set(labels) & set(cameras))


def test_what_is_not_obvious_is_described() -> None:
    assert describe_pairs("a.toml", {"left": "left"}, ["left"]) == ""
    said = describe_pairs("a.toml", {"cam_1": "1"}, ["1", "2"])
    assert said == "cameras of a.toml: cam_1 = 1; not used: 2"

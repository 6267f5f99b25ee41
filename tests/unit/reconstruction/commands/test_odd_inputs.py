"""Broken and odd calibrations, pictures and manifests: each command ends with a line and an exit code.

All of them through all commands, as processes whose memory is measured, take most of an hour of CPU
(tests/nightly); a few quick ones are always tried.
"""

from pathlib import Path

import pytest

from capture_app.common.errors import ExitCode
from tests.unit.reconstruction.commands.calibrations import CALIBRATIONS
from tests.unit.reconstruction.commands.commands import command_line
from tests.unit.reconstruction.commands.odd_session import OddSession, sound_session
from tests.unit.reconstruction.commands.pictures import MANIFESTS, PICTURES
from tests.unit.reconstruction.conftest import Reconstruct

CASES = {
    **{f"calibration: {name}": change for name, change in CALIBRATIONS.items()},
    **{f"pictures: {name}": change for name, change in PICTURES.items()},
    **{f"manifest: {name}": change for name, change in MANIFESTS.items()},
}


@pytest.fixture(scope="session")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sound_session(tmp_path_factory.mktemp("sound"))


def make_odd(case: str, sound: Path, folder: Path) -> Path:
    odd = OddSession(sound, folder / "odd")
    CASES[case](odd)
    odd.save()
    return odd.folder


def test_there_are_two_hundred_of_them() -> None:
    assert len(CASES) >= 200


@pytest.mark.parametrize(
    ("case", "command", "words"),
    [
        (
            "calibration: equal poses, all",
            "stereo",
            "left and right have one pose, as if they were one camera",
        ),
        ("calibration: equal poses, all", "calibrate from session", "one pose"),
        ("calibration: two exchanged", "multiview", "the calibrations of left and right are exchanged"),
        (
            "calibration: mirrored, one",
            "calibrate from session",
            "camera left cannot be right: its rotation is mirrored",
        ),
        ("calibration: distortion 1e9", "tolerance", "without its distortion the picture would be"),
        ("calibration: no focal length", "stereo", "a focal length of 0 px"),
        ("calibration: translation NaN", "multiview", "not valid JSON"),
        ("pictures: 65000x1, one", "compare", "camera left is 65000x1 pixels"),
        ("pictures: 30000x30000", "panorama of pictures", "decoded it takes 2.7 GB of memory"),
        ("pictures: 30000x30000, unsaid", "stereo", "is 30000x30000, but left is 320x240"),
        ("pictures: black", "stereo", "or the static scene has no texture"),
        (
            "pictures: a GIF",
            "calibrate from sfm",
            "000000.png is not an image, or its format is not supported",
        ),
        ("pictures: no images", "panorama", "two pictures or more"),
        ("pictures: one is missing on disk", "tolerance", "is missing"),
        ("manifest: instants all the same", "compare", "do not follow each other in time"),
    ],
)
def test_what_is_odd_is_said(
    case: str, command: str, words: str, sound: Path, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    session = make_odd(case, sound, tmp_path)
    done = reconstruct(*command_line(command, session, tmp_path / "out"))
    assert done.code in (ExitCode.BAD_INPUT, ExitCode.INCOMPLETE)
    assert words in done.complaint
    assert done.out == ""
    assert not (tmp_path / "out").exists()


def test_an_asked_camera_whose_calibration_is_wrong_is_left_out_with_the_reason(
    sound: Path, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    session = make_odd("calibration: mirrored, one", sound, tmp_path)
    done = reconstruct(*command_line("stereo of a pair", session, tmp_path / "out"))
    assert done.code == ExitCode.BAD_INPUT
    assert "left is left out: the calibration of camera left cannot be right: its rotation" in done.err
    assert "camera left is left out, as its calibration is wrong" in done.err


def test_a_camera_without_an_image_is_left_out_of_that_instant_and_named(
    sound: Path, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    session = make_odd("pictures: one image of one camera", sound, tmp_path)
    found = reconstruct("stereo", session, "--instant", 1, "--out", tmp_path / "out", "--json")
    assert found.result["left_out"] == {"middle": "it has no image of instant 1"}
    assert {found.result["reference"], found.result["other"]} == {"left", "right"}
    assert "middle is left out: it has no image of instant 1" in found.err

"""Every command holds a session's calibration against its pictures before it makes anything of it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from reconstruction.scene.calibration.consistency import upside_down
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.conftest import Reconstruct, make_view
from tests.unit.reconstruction.scene.calibration.test_against_pictures import (
    Rig,
    calibrated,  # noqa: F401 - a fixture
)
from tests.unit.reconstruction.scene.calibration.test_kept_calibration import RIG

TWICE = {**RIG, "b": replace(RIG["b"], rotation=RIG["a"].rotation, translation=RIG["a"].translation)}
EXCHANGED = {**RIG, "b": RIG["c"], "c": RIG["b"]}
MILLIMETRES = {name: replace(view, translation=1000 * view.translation) for name, view in RIG.items()}
ANOTHER = {
    name: make_view((0.4 * k, 0.3 * (k % 2), 0.0), yaw=9 - 7 * k, pitch=8.0 * (-1) ** k)
    for k, name in enumerate(RIG)
}
FOLDED = replace(RIG["d"], distortion=np.array([-5.0, 0, 0, 0, 0]))
FAULTS: dict[str, tuple[Rig, tuple[str, ...]]] = {
    "one pose twice, and lenses that fold": (
        {**TWICE, "c": replace(FOLDED, translation=RIG["c"].translation), "d": FOLDED},
        ("has 3 faults: ", "camera d cannot be right: its distortion folds", "a and b have one pose"),
    ),
    "exchanged": (EXCHANGED, ("the calibrations of b and c are exchanged",)),
    "millimetres": (MILLIMETRES, ("neighbouring cameras stand 201 m apart: its unit is not the metre",)),
    "another rig's": (ANOTHER, ("it does not fit the pictures: ",)),
}  # fmt: skip
COMMANDS: dict[str, tuple[str, ...]] = {
    "stereo": ("--out", "out"),
    "multiview": ("--out", "out"),
    "panorama": ("--out", "out"),
    "tolerance": (),
    "compare": ("--out", "out"),
    "time": (),
}


# Exchanged cameras are found in each command below.
@pytest.mark.parametrize("fault", sorted({*FAULTS} - {"exchanged"}))
def test_all_faults_are_in_one_message(
    calibrated: Callable[[Rig], Path], reconstruct: Reconstruct, fault: str
) -> None:
    views, said = FAULTS[fault]
    refused = reconstruct("time", calibrated(views))
    assert refused.code == 3
    for words in said:
        assert words in refused.complaint


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_asks_before_it_makes_anything(
    calibrated: Callable[[Rig], Path], reconstruct: Reconstruct, tmp_path: Path, command: str
) -> None:
    views, (said,) = FAULTS["exchanged"]
    options = [str(tmp_path / "out") if word == "out" else word for word in COMMANDS[command]]
    refused = reconstruct(command, calibrated(views), *options)
    assert refused.code == 3
    assert said in refused.complaint
    assert not (tmp_path / "out").exists()


LEFT_OUT: dict[str, tuple[Rig, set[str], str]] = {
    "one pose twice": (TWICE, {"a", "c", "d"}, "b is left out: a and b have one pose"),
    "upside down": ({**RIG, "c": upside_down(RIG["c"])}, {"a", "b", "d"}, "c is left out: the pictures of c"),
    "a lens that folds": ({**RIG, "d": FOLDED}, {"a", "b", "c"}, "d is left out: the calibration of"),
}  # fmt: skip


@pytest.mark.parametrize("fault", LEFT_OUT)
def test_a_single_bad_camera_is_left_out_by_name(
    calibrated: Callable[[Rig], Path], capsys: pytest.CaptureFixture[str], fault: str
) -> None:
    views, good, said = LEFT_OUT[fault]
    dataset = Dataset.open(calibrated(views))
    used = Scene(dataset).given
    assert used is not None
    assert set(used.cameras) == good
    assert said in capsys.readouterr().err

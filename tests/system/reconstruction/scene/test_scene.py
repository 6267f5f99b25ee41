"""A scene: one for each command, chosen once, and the same in memory and on disk."""

from pathlib import Path

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.reading.reader import Session
from reconstruction.common.drawing import colour_depth
from reconstruction.scene import scene as module
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.conftest import Reconstruct


def test_a_command_opens_its_session_and_chooses_a_calibration_once(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, chosen = list[object](), list[object]()
    choose, read = module.choose_calibration, Dataset.open.__func__  # type: ignore[attr-defined]
    monkeypatch.setattr(module, "choose_calibration", lambda data: (chosen.append(data), choose(data))[1])
    monkeypatch.setattr(Dataset, "open", classmethod(lambda *given: (opened.append(given), read(*given))[1]))
    for command in (("compare", "--study", "burst"), ("stereo",)):
        opened.clear()
        chosen.clear()
        name, *options = command
        assert reconstruct(name, boards.folder, *options, "--out", tmp_path / name).code == 0
        assert (len(opened), len(chosen)) == (1, 1)


def test_why_no_calibration_is_found_is_known_once(boards: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = list[int]()

    def guess(_: object) -> None:
        calls.append(1)
        raise BadInputError("nothing to see")

    monkeypatch.setattr(module, "guess_calibration", guess)
    monkeypatch.setattr(Session, "calibration", lambda _: None)
    scene = Scene(Dataset(boards))
    assert (scene.given, scene.known_views, scene.unit, scene.source) == (None, {}, "", "none")
    with pytest.raises(BadInputError, match="nothing to see"):
        scene.calibration  # noqa: B018
    assert scene.problem == "nothing to see"
    assert len(calls) == 1


def test_a_smaller_scene_leaves_the_larger_as_it_is(boards: Session) -> None:
    scene = Scene(Dataset(boards))
    assert scene.fitted(images=1) is scene
    other = scene.calibrated(scene.given)
    assert other.dataset is scene.dataset
    assert other.views.keys() == scene.views.keys()


def test_no_depth_at_all_can_be_coloured() -> None:
    assert colour_depth(np.zeros((1, 0)), 1.0, 2.0).shape == (1, 0, 3)

"""Splats in a comparison: what a camera that was left out would see, in step and apart."""

from typing import Any

import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.method.score import Context
from reconstruction.methods.splat.splat_study import SplatStudy, _close_up
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene


def study(session: Session, **settings: Any) -> SplatStudy:
    return SplatStudy(Context(scene=Scene(Dataset(session)), **settings))


def test_it_is_made_only_if_asked_for(boards: Session) -> None:
    assert "--splats" in study(boards).unasked()
    assert not study(boards, options={"splats": True}).unasked()
    assert not study(boards, studies=("stereo", "splat")).unasked()


def test_three_cameras_are_too_few(boards: Session) -> None:
    asked = study(boards, studies=("splat",))
    assert asked.run(asked.known).skipped == "it needs 4 cameras"


def test_a_close_up_shows_the_largest_part_in_the_pictures_shape() -> None:
    moving = np.zeros((240, 320), bool)
    moving[100:180, 200:230] = moving[3:9, 3:9] = True
    rows, columns = _close_up(moving)
    assert rows.start < 100 < 180 < rows.stop
    assert columns.start < 200 < 230 < columns.stop
    assert (columns.stop - columns.start) / (rows.stop - rows.start) == pytest.approx(4 / 3, rel=0.02)
    assert rows.stop - rows.start < 120

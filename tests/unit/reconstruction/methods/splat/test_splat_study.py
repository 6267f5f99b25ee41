"""Splats in a comparison: what a camera that was left out would see, in step and apart."""

from typing import Any

from capture_app.session.reading.reader import Session
from reconstruction.method.score import Context
from reconstruction.methods.splat.splat_study import SplatStudy
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

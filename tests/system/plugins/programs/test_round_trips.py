"""A session that is exported and imported is the session that it was."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.session.format.manifest import ImageRecord
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.unit.plugins.programs.conftest import Make, make  # noqa: F401 - a fixture
from tests.unit.plugins.programs.test_round_trips import SAMPLE, pixels, there_and_back, times_of


def coarse(session: Session, image: ImageRecord) -> np.ndarray[Any, Any]:
    """An eighth of the size, without the noise that videos lose."""
    found = pixels(session, image)
    return cv2.resize(found, None, fx=1 / 8, fy=1 / 8, interpolation=cv2.INTER_AREA).astype(float)


@pytest.mark.parametrize("to", ["pose2sim", "caliscope"])
def test_videos_come_back_with_every_time(to: str, tmp_path: Path) -> None:
    taken = Session.open(SAMPLE)
    again = there_and_back(taken, to, tmp_path)
    assert verify(again) == []
    assert list(map(times_of, again.manifest.images)) == list(map(times_of, taken.manifest.images))
    assert again.manifest.cameras == taken.manifest.cameras
    assert again.manifest.burst == taken.manifest.burst
    assert again.manifest.origin == "imported"
    assert again.calibration() == taken.calibration()
    for image, before in zip(again.manifest.images, taken.manifest.images, strict=True):
        change = coarse(again, image) - coarse(taken, before)
        assert np.abs(change).mean() < 1.5
        assert np.abs(change.mean((0, 1))).max() < 0.4

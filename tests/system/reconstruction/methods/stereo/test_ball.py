"""A real ball before two real cameras has a distance in pictures of one time, and none 4 frames apart.

A pair cannot see an offset by which the ball has moved along the epipolar line only: it then takes the
displacement for another distance. So every instant is judged by how far, measured, the ball has moved across.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.companions.importing.import_options import ImportOptions
from reconstruction.common.geometry import Array
from reconstruction.methods.stereo.stereo_pair import StereoPair
from reconstruction.scene.calibration.soundness import calibrated_views
from reconstruction.scene.dataset import Dataset
from tests.imported import import_one

LATE = 4
ACROSS_PX = 4.0
"""A ball 9 to 25 px wide that has moved less than this across the rows may still be matched."""
SAME_ROW_PX = 4.0
DISPARITIES = (60, 260)
"""From the hand that throws to the net, px; nearer things and the background are not asked for."""


@dataclass(frozen=True)
class Seen:
    """The ball in a rectified picture: its centre's row, its pixels (bool), whether all of it is there."""

    row: float
    pixels: Array
    whole: bool


class Throw:
    """The recording as a calibrated pair, and where the ball is: the one round bright thing that moves."""

    def __init__(self, folder: Path, scratch: Path) -> None:
        options = ImportOptions(fps=60, calibration=(str(folder / "calibration"),), unit="in")
        self.session = import_one([str(folder)], scratch, "ball", options)
        self.dataset = Dataset.open(self.session.folder)
        calibration = self.session.calibration()
        assert calibration is not None
        views = calibrated_views(self.dataset, calibration)
        self.pair = StereoPair(views["L"], views["R"], DISPARITIES)
        self.left, self.right = self.track("L"), self.track("R")

    def track(self, name: str) -> dict[int, Seen]:
        """By instant, where one camera sees the ball."""
        canvas = self.pair.rectification
        seen = [
            canvas.remap(self.dataset.grey(name, k), other=name == "R") for k in self.dataset.instants(name)
        ]
        background = np.median(np.stack([image for image, _ in seen]), axis=0).astype(np.int16)
        found = {}
        for k, (image, sight) in enumerate(seen):
            mask = cv2.medianBlur(((image.astype(np.int16) - background > 20) & sight).astype(np.uint8), 3)
            _, labels, stats, centres = cv2.connectedComponentsWithStats(mask)
            round_ones = [
                number for number, (_, _, width, height, area) in enumerate(stats)
                if number and area >= 40 and 0.6 < width / height < 1.7 and area > 0.55 * width * height
            ]  # fmt: skip
            if round_ones:
                ball = max(round_ones, key=lambda number: int(stats[number, 4]))
                pixels = labels == ball
                edge = cv2.erode(sight.astype(np.uint8), np.ones((9, 9), np.uint8)) == 0
                found[k] = Seen(float(centres[ball][1]), pixels, not (pixels & edge).any())
        return found

    @cached_property
    def in_both(self) -> list[int]:
        """The instants with the whole ball in both views, now and `LATE` frames later in the right one."""
        return [
            k for k, a in self.left.items()
            if (b := self.right.get(k)) is not None and a.whole and b.whole
            and abs(a.row - b.row) < SAME_ROW_PX and k + LATE in self.right
        ]  # fmt: skip

    def across_px(self, instant: int) -> float:
        """How far the ball moves across the rows within `LATE` frames, px."""
        return abs(self.right[instant + LATE].row - self.right[instant].row)

    def covered(self, instant: int, late: int) -> float:
        """The share of the ball's pixels with a distance, the right camera's picture `late` frames on."""
        found = self.pair.compute_depth(
            self.dataset.grey("L", instant), self.dataset.grey("R", instant + late)
        )
        ball = self.pair.rectification.to_reference(self.left[instant].pixels.astype(np.uint8)) > 0
        return float((found.depth[ball] > 0).mean())

    def judge(self, instants: Iterable[int]) -> None:
        """There when synchronized; gone when late, where the ball has moved across the rows."""
        for k in instants:
            assert self.covered(k, 0) > 0.7, k
            if self.across_px(k) > ACROSS_PX:
                assert self.covered(k, LATE) < 0.05, k


@pytest.fixture(scope="module")
def throw(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Throw:
    return Throw(shared / "footage" / "ball_launch", tmp_path_factory.mktemp("ball"))


@pytest.mark.shared
def test_a_real_ball_is_there_when_synchronized_and_gone_four_frames_later(throw: Throw) -> None:
    middle = throw.in_both[len(throw.in_both) // 2]
    assert throw.across_px(middle) > ACROSS_PX
    throw.judge([middle])

"""How late a camera is relative to another, from a drawn session of four instants."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import View
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from reconstruction.time_offsets.crossings import OffsetFit
from reconstruction.time_offsets.instant_votes import Change, Step
from reconstruction.time_offsets.pair_offset import PairOffsets
from tests.unit.reconstruction.commands.odd_session import sound_session
from tests.unit.reconstruction.commands.test_odd_inputs import make_odd
from tests.unit.reconstruction.conftest import FOCAL, PERIOD_NS, VIEWS, Scene, write_session

PAIR = {name: VIEWS[name] for name in ("left", "right")}


def fall(time: float) -> tuple[float, float]:
    """Half across, and faster and faster down."""
    return 0.05 * time - 0.3, -0.5 + 0.12 * time + 0.012 * time**2


@pytest.fixture(scope="module")
def drawn(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> OpenScene:
    """A board that falls before two cameras, the right one half a frame early."""
    falling = replace(scene, boards=[*scene.boards[:-1], replace(scene.boards[-1], path=fall)])
    root = tmp_path_factory.mktemp("falling")
    session = write_session(root, falling, PAIR, instants=4, truth=False, late={"right": -0.5})
    opened = OpenScene(Dataset.open(session.folder))
    # Its calibration is checked once, for all tests.
    assert {*opened.views} == {*PAIR}
    return opened


def test_half_a_frame_is_measured_within_its_error(drawn: OpenScene) -> None:
    fit = PairOffsets(drawn).measure("left", "right")
    assert fit.offset_ms is not None, fit.reason
    assert fit.sd_ms is not None
    assert fit.sd_ms < 0.5
    assert abs(fit.offset_ms + 0.5 * PERIOD_NS / 1e6) < 3 * fit.sd_ms
    assert len(fit.instants) >= 3
    assert fit.misfit_px is None


def test_of_a_camera_without_images_nothing_is_measured_and_it_is_named(tmp_path: Path) -> None:
    session = make_odd("pictures: no images of one camera", sound_session(tmp_path), tmp_path)
    pairs = PairOffsets(OpenScene(Dataset.open(session)))
    for pair in (("left", "right"), ("right", "left")):
        assert pairs.measure_anywhere(*pair).reason == "left has no images"


@pytest.mark.parametrize(
    ("late_frames", "step", "told"), [(0, 1, True), (-2, 2, False), (2, -2, True), (0, 2, False)]
)
def test_a_step_is_told_only_where_both_offsets_have_images(
    late_frames: int, step: int, told: bool, drawn: OpenScene
) -> None:
    """Two discs of two periods agree at one offset each; where one has no images left, the other one wins."""
    change = Change(steps=(Step(instant=2, frames=step, earliest=2, latest=2),))
    fit = OffsetFit(offset_ms=late_frames * PERIOD_NS / 1e6, sd_ms=0.5, change=change)
    placed = PairOffsets(drawn)._placed(fit, ("left", "right"))
    assert ("could show otherwise" in placed.reason) != told
    assert bool(placed.change) == told


def sway(view: View, time: float) -> View:
    """Where a camera on a boat stands."""
    at = np.array([0.06 * time, 0.09 * np.sin(1.3 * time), 0.05 * time])
    return replace(view, translation=view.translation - view.rotation @ at)


def test_cameras_of_one_boat_move_and_those_on_tripods_do_not(
    scene: Scene, drawn: OpenScene, tmp_path: Path
) -> None:
    assert PairOffsets(drawn).moving(PAIR) == {}
    session = write_session(tmp_path, scene, PAIR, instants=4, truth=False, moved=sway)
    motion = PairOffsets(OpenScene(Dataset.open(session.folder))).moving(PAIR)
    assert {name: px > 5 for name, (px, _) in motion.items()} == {"left": True, "right": True}


class OtherViews(OpenScene):
    """A drawn scene as another calibration has it, with what was measured in its pictures before."""

    def __init__(self, drawn: OpenScene, **views: View) -> None:
        self.__dict__ |= drawn.__dict__
        self._views = views

    @property
    def views(self) -> dict[str, View]:
        return self._views


def with_views(drawn: OpenScene, **views: View) -> PairOffsets:
    return PairOffsets(OtherViews(drawn, **views))


def test_a_calibration_that_is_off_at_rest_is_corrected_and_said(drawn: OpenScene) -> None:
    turned, right = cv2.Rodrigues(np.array([0.02, 0.0, 0.0]))[0], PAIR["right"]
    off = replace(right, rotation=turned @ right.rotation, translation=turned @ right.translation)
    fit = with_views(drawn, left=PAIR["left"], right=off).measure("left", "right")
    assert fit.offset_ms == pytest.approx(-0.5 * PERIOD_NS / 1e6, abs=1.5)
    # The distance of 6 pixels is shared by both pictures.
    assert fit.misfit_px == pytest.approx(0.02 * FOCAL / np.sqrt(2), abs=0.5)


def test_it_is_said_why_a_pair_shows_no_offset(scene: Scene, drawn: OpenScene, tmp_path: Path) -> None:
    still = write_session(tmp_path, scene, PAIR, instants=3, truth=False, frozen=True)
    fit = PairOffsets(OpenScene(Dataset.open(still.folder))).measure("left", "right")
    assert (fit.offset_ms, fit.reason[:21]) == (None, "too few moving points")
    same = with_views(drawn, left=PAIR["left"], right=PAIR["left"]).measure("left", "right")
    assert (same.offset_ms, same.reason) == (None, "both cameras are at the same place")
    alone = with_views(drawn, left=PAIR["left"]).measure("left", "right")
    assert (alone.offset_ms, alone.reason) == (None, "right has no calibration")


def test_an_offset_is_searched_near_another_at_the_instants_that_both_allow(drawn: OpenScene) -> None:
    """As for recordings without common times: half a frame early is what 30 ms early and its error hold."""
    pairs, exact_ms = PairOffsets(drawn), -0.5 * PERIOD_NS / 1e6
    fit = pairs.measure("left", "right", 9, rough=(exact_ms - 14, 60.0))
    assert fit.offset_ms == pytest.approx(exact_ms, abs=1.5)
    # Left's last instant is after the second's last, and those for another offset are to be there, too.
    assert fit.examined == 3
    near_ms = exact_ms + 12
    for beside_ms, examined in ((near_ms + 20, 2), (near_ms + 40, 1), (near_ms - 20, 3), (near_ms - 40, 2)):
        beside = pairs.measure("left", "right", 9, rough=(near_ms, 60.0), beside_ms=beside_ms)
        assert beside.examined == examined
    assert pairs.measure("left", "right", 2, rough=(exact_ms, 60.0)).examined == 2
    # Beyond its error nothing is looked for.
    assert pairs.measure("left", "right", 9, rough=(exact_ms + 90, 60.0)).offset_ms is None

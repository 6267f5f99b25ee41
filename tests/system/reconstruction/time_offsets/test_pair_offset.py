"""How late a camera is, from pictures alone: rendered, at fractions of frames; and of a real ball."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.method.timing import measure_pair_timing
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from reconstruction.time_offsets.pair_offset import PairOffsets
from tests.imported import import_one
from tests.unit.reconstruction.conftest import FOCAL, PERIOD_NS, VIEWS, Reconstruct, Scene, write_session
from tests.unit.reconstruction.time_offsets.cut_apart import wander

PAIR = {name: VIEWS[name] for name in ("left", "right")}


def fall(time: float) -> tuple[float, float]:
    """Half across, and faster and faster down."""
    return 0.05 * time - 0.3, -0.5 + 0.12 * time + 0.012 * time**2


@pytest.mark.parametrize("late", [-1.6, -0.5, 0, 0.3, 2])
def test_fractions_of_a_frame_are_found_from_either_side(scene: Scene, tmp_path: Path, late: float) -> None:
    falling = replace(scene, boards=[*scene.boards[:-1], replace(scene.boards[-1], path=fall)])
    session = write_session(tmp_path, falling, PAIR, instants=6, truth=False, late={"right": late})
    offsets = offsets_of(session)
    for pair, sign in ((("left", "right"), 1), (("right", "left"), -1)):
        found = offsets.measure(*pair)
        assert found.offset_ms is not None, found.reason
        assert found.sd_ms is not None
        assert found.sd_ms < 0.5
        assert abs(found.offset_ms - sign * late * PERIOD_NS / 1e6) < 3 * found.sd_ms
        assert len(found.instants) >= 3
        timing = measure_pair_timing(offsets, pair)
        assert timing.synchronized == (late == 0)
        assert timing.offset == (late != 0)


def test_a_bumped_tripod_is_no_dropped_frame(scene: Scene, tmp_path: Path, reconstruct: Reconstruct) -> None:
    """From instant 16 on all that the right camera sees is 4 px lower: "3 frames later", it was said."""
    wandering = replace(scene, boards=[*scene.boards[:-1], replace(scene.boards[-1], path=wander)])

    def bump(view: View, time: float) -> View:
        turned = (
            cv2.Rodrigues(np.array([4 / FOCAL, 0, 0]))[0]
            if view is PAIR["right"] and time >= 16
            else np.eye(3)
        )
        return replace(view, rotation=turned @ view.rotation, translation=turned @ view.translation)

    session = write_session(tmp_path, wandering, PAIR, instants=24, truth=False, moved=bump)
    found = offsets_of(session).measure("left", "right")
    assert found.offset_ms is not None, found.reason
    assert found.sd_ms is not None
    assert abs(found.offset_ms) < 3 * found.sd_ms
    assert not found.change
    said = reconstruct("time", session.folder).out
    assert "right itself was moved by 4." in said
    assert "before instant 16: only instants 0 to 14 are measured" in said
    assert "--repair-drops" not in said


def test_it_is_said_why_nothing_can_be_told(scene: Scene, tmp_path: Path) -> None:
    still = write_session(tmp_path / "still", scene, PAIR, instants=3, truth=False, frozen=True)
    found = offsets_of(still).measure("left", "right")
    assert found.offset_ms is None
    assert "too few moving points" in found.reason


FPS = 60


def offsets_of(session: Session) -> PairOffsets:
    return PairOffsets(OpenScene(Dataset.open(session.folder)))


def ball(shared: Path, tmp_path: Path, late: int) -> PairOffsets:
    """The thrown ball with the right camera's pictures so many frames later than their times say."""
    recording = shared / "footage" / "ball_launch"
    names = sorted(
        (path.name for path in (recording / "L").iterdir()), key=lambda name: int(name.split(".")[0])
    )
    for place in range(4, len(names) - 4):
        for camera, step in (("L", 0), ("R", late)):
            link = tmp_path / "ball" / camera / f"{place:03d}.png"
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(recording / camera / names[place + step])
    options = ImportOptions(fps=FPS, calibration=(str(recording / "calibration"),), unit="in")
    session = import_one([str(tmp_path / "ball")], tmp_path / "sessions", "ball", options)
    return offsets_of(session)


@pytest.mark.shared
@pytest.mark.parametrize("late", [-3, 0, 4])
def test_a_real_ball_tells_how_many_frames_late_a_camera_is(shared: Path, tmp_path: Path, late: int) -> None:
    opened = ball(shared, tmp_path, late).scene
    for pair, sign in ((("L", "R"), 1), (("R", "L"), -1)):
        found = measure_pair_timing(PairOffsets(opened), pair)
        assert found.late_ms is not None, found.reason
        assert found.uncertainty_ms is not None
        assert found.uncertainty_ms < 3.5
        assert abs(found.late_ms - sign * late * 1000 / FPS) < 1.5 * found.uncertainty_ms
        # In some pairs the ball is in front of a bright door: half of its outline is missing in one camera.
        assert found.synchronized == (late == 0)
        assert found.offset == (late != 0)

"""Instants are chosen where something moves before every camera."""

from dataclasses import replace
from pathlib import Path

from reconstruction.scene.dataset import Dataset
from reconstruction.scene.instant_choice import choose_moving_instants
from reconstruction.scene.moving_pixels import SceneMotion
from tests.unit.reconstruction.conftest import VIEWS, Scene, write_session

PAIR = ("left", "right")


def test_still_parts_of_a_burst_are_left_out(scene: Scene, tmp_path: Path) -> None:
    def late_jump(time: float) -> tuple[float, float]:
        return (0.0, 0.25 - 0.09 * max(0.0, time - 5))

    scene = replace(scene, boards=[*scene.boards[:-1], replace(scene.boards[-1], path=late_jump)])
    session = write_session(tmp_path, scene, {name: VIEWS[name] for name in PAIR}, instants=10, truth=False)
    motion = SceneMotion(Dataset.open(session.folder), 1)
    chosen = choose_moving_instants(motion, PAIR, range(10), 3)
    assert len(chosen) == 3
    assert min(chosen) >= 5
    # Where nothing moves they are spread over all that there are.
    assert choose_moving_instants(motion, PAIR, range(4), 2) == [0, 3]

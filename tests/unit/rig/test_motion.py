"""What moves in small pictures is seen; noise, light and what has become usual are not."""

import numpy as np
import pytest

from capture_app.rig.motion_watch import LEARN, WHOLE, MotionWatch

HEIGHT, WIDTH = 90, 160


class Scene:
    """Pictures of a still scene with noise, and what stands in it."""

    def __init__(self, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.ground = np.kron(self.rng.uniform(40, 200, (9, 16)), np.ones((10, 10)))

    def picture(self, at: int | None = None, light: float = 1.0) -> np.ndarray:
        """`at`: how far right something bright stands, px; `light`: of all."""
        seen = self.ground.copy()
        if at is not None:
            seen[50:70, at : at + 12] = 250 - seen[50:70, at : at + 12] / 2
        return np.clip(seen * light + self.rng.normal(0, 3, seen.shape), 0, 255).astype(np.uint8)


def taught(watch: MotionWatch, scene: Scene) -> MotionWatch:
    for _ in range(3 * LEARN):
        assert not watch.moved("a", scene.picture())
    return watch


@pytest.mark.parametrize("at", [0, 70, 148])
def test_what_comes_in_is_seen_at_once_and_what_stays_no_longer(at: int) -> None:
    scene = Scene()
    watch = taught(MotionWatch(), scene)
    assert watch.moved("a", scene.picture(at))
    assert not [watch.moved("a", scene.picture(at)) for _ in range(60)][-1]
    assert not watch.moved("b", scene.picture(at))


def test_pictures_of_another_size_are_learned_anew() -> None:
    scene = Scene()
    watch = taught(MotionWatch(), scene)
    assert not watch.moved("a", scene.picture(70)[::2, ::2])


def test_only_the_region_is_looked_at() -> None:
    scene = Scene()
    for region, seen in (((0.0, 0.0, 0.4, 1.0), False), ((0.5, 0.4, 1.0, 1.0), True), (WHOLE, True)):
        watch = taught(MotionWatch(region), scene)
        assert watch.moved("a", scene.picture(100)) == seen

import hashlib
import subprocess
import sys
import time

import numpy as np
import pytest

from capture_app.plugins.cameras.sim.rendering.scene import Scene, load
from capture_app.plugins.cameras.sim.scenes.stages import DEFINITIONS
from tests.unit.plugins.cameras.sim.test_scene import (
    EXPOSURE_NS,
    ROW_NS,
    SCALE,
    START_NS,
    around,
    picture,
    scene,  # noqa: F401 - a fixture
)

STUDIO_MEANS = (
    (71.034, 125.041, 119.072, 87.466),
    (55.075, 112.769, 159.540, 101.119),
    (58.424, 112.368, 130.731, 132.621),
    (70.995, 112.143, 126.806, 115.478),
)
"""Mean level of each sixteenth of a picture, 120 x 160 px."""


def test_same_arguments_give_the_same_bytes_in_another_process(scene: Scene) -> None:
    shot = picture(scene)
    assert np.array_equal(shot, picture(scene))
    code = (
        "import hashlib, sys; from capture_app.plugins.cameras.sim.rendering.scene import load;"
        "assert 'open3d' not in sys.modules;"  # slow to import, and absent where there is no reconstruction
        f"s = load('studio', scale={SCALE});"
        f"s.render('cam00', 5, {EXPOSURE_NS}, {ROW_NS}, seed=9);"  # what was drawn before does not matter
        f"p = s.render('cam00', {START_NS}, {EXPOSURE_NS}, {ROW_NS}, seed=1);"
        "print(hashlib.sha256(p.tobytes()).hexdigest())"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.split()[-1] == hashlib.sha256(shot.tobytes()).hexdigest()


def test_static_parts_are_rendered_ahead_without_blocking_drafts() -> None:
    ahead = Scene("studio", DEFINITIONS["studio"], scale=SCALE)
    ahead.prepare("cam00")
    assert ahead.draft(0.5).render("cam00", START_NS, 4_000_000, ROW_NS, seed=1).any()
    while "cam00" not in ahead._still:
        time.sleep(0.01)
    assert np.array_equal(picture(ahead), picture(Scene("studio", DEFINITIONS["studio"], scale=SCALE)))


def test_blur_grows_with_exposure(scene: Scene) -> None:
    def sharpness(exposure_ns: int) -> float:
        # Centred on one instant, without the noise of the sensor: the mean of several seeds.
        start = START_NS - exposure_ns // 2
        shots = [picture(scene, start_ns=start, seed=s, exposure_ns=exposure_ns) for s in range(3)]
        shot = np.mean(shots, axis=0).mean(axis=2)
        movers = scene.ground_truth("cam00", START_NS, 0, ROW_NS)[2]
        return float(np.abs(np.diff(shot, axis=1))[around(movers, 2)[:, 1:]].mean())

    short, middle, long = (sharpness(ms * 1_000_000) for ms in (2, 16, 48))
    assert short > 1.04 * middle > 1.04 * 1.04 * long


def test_the_studio_looks_as_it_always_did() -> None:
    """Sessions are compared over years: the same arguments still give the same picture."""
    shot = load("studio").render("cam00", 5_000_000_000, 4_000_000, 11_111, seed=1)
    means = shot.reshape(4, 120, 4, 160, 3).mean(axis=(1, 3, 4))
    # The rounding of another processor moves these by 0.001, a ball that lies 3 mm elsewhere by 0.016.
    assert means == pytest.approx(np.array(STUDIO_MEANS), abs=0.005)


@pytest.mark.parametrize("name", ["pinwheel", "crossing"])
def test_the_other_scenes_show_their_moving_objects_in_every_view(name: str) -> None:
    scene = load(name, scale=SCALE)
    for view in scene.views:
        shot = picture(scene, view, start_ns=8_000_000_000)
        assert np.percentile(shot, 1) < 80
        assert np.percentile(shot, 99) > 180
        depth, things, movers = scene.ground_truth(view, 8_000_000_000, EXPOSURE_NS, ROW_NS)
        assert (depth > 0).all()
        assert movers.mean() > 0.02
        assert {*np.unique(things[movers])} <= {*scene._thing_of.values()}

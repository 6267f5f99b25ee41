"""Choice of a camera pair for stereo."""

import numpy as np

from reconstruction.scene.pairs import Features, choose_stereo_pair
from tests.unit.reconstruction.conftest import HEIGHT, WIDTH, make_view


def test_a_level_baseline_is_preferred_to_a_slanted_one_of_similar_length() -> None:
    places = {"a": (0.0, 0.0, 0.0), "slanted": (0.12, 0.12, 0.0), "level": (0.16, 0.0, 0.0)}
    views = {name: make_view(place) for name, place in places.items()}
    rng = np.random.default_rng(3)
    pixels = rng.uniform((60, 60), (WIDTH - 20, HEIGHT - 20), (300, 2))
    points = views["a"].unproject(pixels, np.full(300, 3.0))
    descriptors = rng.normal(0, 1, (300, 128)).astype(np.float32)
    features = {
        name: Features(view.project(points @ view.rotation.T + view.translation), descriptors, np.ones(300))
        for name, view in views.items()
    }
    assert choose_stereo_pair(views, features).cameras == ("a", "level")

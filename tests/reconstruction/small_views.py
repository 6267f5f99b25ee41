"""Small cameras for tests of what they see of each other."""

import numpy as np

from reconstruction.common.geometry import View
from reconstruction.depth.view_overlap import grid_points
from reconstruction.multiview.source_views import choose_source_views

WIDTH, HEIGHT, FOCAL = 128, 96, 110.0
MATRIX = np.array([[FOCAL, 0, 63.5], [0, FOCAL, 47.5], [0, 0, 1.0]])
PLACES = {"left": (-0.15, 0.0), "middle": (0.0, 0.02), "right": (0.15, 0.0)}


def view_at(x: float, y: float = 0.0, z: float = 0.0) -> View:
    """A camera that looks along z."""
    return View(WIDTH, HEIGHT, MATRIX, np.zeros(5), np.eye(3), -np.array([x, y, z]))


def choose_by_depth(views: dict[str, View]) -> dict[str, tuple[str, ...]]:
    """The sources for a scene 2 m away."""
    return choose_source_views(views, {name: grid_points(view, 2.0) for name, view in views.items()})

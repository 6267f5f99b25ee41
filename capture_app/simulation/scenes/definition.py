"""The definition of a scene: things that stand still, bodies that move, and the cameras."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from capture_app.simulation.scenes.materials import Picture
from capture_app.simulation.scenes.moving_bodies import Part, Poses, Series

Point = tuple[float, float, float]


@dataclass(frozen=True)
class SceneDefinition:
    """One scene; `pictures`, then `fixtures`, draw from the same random generator."""

    cameras: Mapping[str, tuple[Point, Point]]
    """Where each camera is and the point that it looks at, in m."""
    pictures: Callable[[np.random.Generator], dict[str, Picture]]
    """Textures by name."""
    fixtures: Callable[[np.random.Generator], list[Part]]
    """Parts that stand still."""
    parts: Callable[[], dict[str, Part]]
    """Rigid moving parts by name."""
    poses: Callable[[Series], dict[str, Poses]]
    """Poses of the parts at the times, in s, by the part's name."""

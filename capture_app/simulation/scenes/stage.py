"""What a scene is made of: things that stand still, bodies that move, and the cameras that look at them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from capture_app.simulation.scenes.meshes import Mesh
from capture_app.simulation.scenes.motion import Poses, Series
from capture_app.simulation.scenes.movers import Part
from capture_app.simulation.scenes.textures import Picture

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Fixture:
    """A thing that stands still."""

    thing: str
    meshes: list[Mesh]


@dataclass(frozen=True)
class Stage:
    """One scene; its generator is given to its makers in the order of the fields."""

    cameras: Mapping[str, tuple[Point, Point]]
    """Where each camera is and the point that it looks at, in m."""
    pictures: Callable[[np.random.Generator], dict[str, Picture]]
    """Textures by name."""
    fixtures: Callable[[np.random.Generator], list[Fixture]]
    parts: Callable[[], dict[str, Part]]
    """Rigid moving parts by name."""
    poses: Callable[[Series], dict[str, Poses]]
    """Poses of the parts at the times, in s, by the part's name."""

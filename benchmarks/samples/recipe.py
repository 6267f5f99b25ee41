"""Recipe of a rendered session, `recipe.json`: what to take, and the take once it is made.

With its take, a recipe always gives the same bytes, however the engine changes (but for Embree). Without one,
the engine takes the burst in virtual time at `at_s` seconds; `seed` draws clocks, networks and sensors:

    {"name": "mine", "scene": "studio", "created": "2026-01-31T12:00:00Z", "seed": 7, "at_s": 10, "frames": 5,
     "cameras": [{"name": "cam00", "profile": "phone-a"}, {"name": "left", "view": "cam05", "profile": "pi"}]}

Scenes are `studio`, `pinwheel`, `crossing`, `board`, `led-panel`, and `bars`, a test card without a renderer.
"""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from capture_app.common.bounds import Count, Positive
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import BadInputError
from capture_app.common.names import Name
from capture_app.protocol.messages import EventValue
from capture_app.session.files.untrusted_files import read_struct
from capture_app.session.format.manifest import RECIPE, BurstRecord, CameraRecord, MissingImage

SCHEMA_VERSION = 1


class Trigger(StrEnum):
    """How the burst is triggered."""

    SYNCHRONIZED = "synchronized"
    """By the engine: clocks synchronized, phases aligned, frames picked by their timestamps."""
    NAIVE = "naive"
    """By a message: each camera takes the frames that follow its arrival."""


class _Part(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of a recipe's parts."""


class CameraRecipe(_Part, frozen=True, kw_only=True):
    """One camera: its name, its model (a profile of the simulator) and its view of the scene."""

    name: Name
    profile: str = "phone-a"
    view: str = ""
    """Name of the view; empty for the view with the camera's name."""


class RecipeFrame(_Part, frozen=True, kw_only=True):
    """A frame of the take: its times by the camera's, the leader's and the true clock, in ns, with errors."""

    camera: Name
    instant: Count
    sequence: Count
    true_ns: int
    """True start of the first row's exposure."""
    local_ns: int
    leader_ns: int
    exposure_ns: Positive
    exposure_start_ns: int | None = None
    uncertainty_ns: Count | None = None
    hard_bound_ns: Count | None = None
    late: bool = False
    outlier_ns: int = 0


class Take(_Part, frozen=True, kw_only=True):
    """Output of the simulated rig: all of a session except the images."""

    software: str
    cameras: tuple[CameraRecord, ...]
    burst: BurstRecord
    frames: tuple[RecipeFrame, ...]
    missing: tuple[MissingImage, ...] = ()
    events: tuple[dict[str, EventValue], ...] = ()
    clocks: dict[str, SimulatedClock] = {}


class Recipe(_Part, frozen=True, kw_only=True):
    """How a session is rendered; the same recipe gives the same bytes on machines of the same kind."""

    name: Name
    scene: str
    cameras: Annotated[tuple[CameraRecipe, ...], Meta(min_length=1)]
    created: str
    """The session's time of capture, RFC 3339, UTC."""
    note: str = ""
    seed: Count = 0
    trigger: Trigger = Trigger.SYNCHRONIZED
    at_s: Annotated[float, Meta(ge=0, le=3600)] = 10.0
    """True time of the burst's first instant from switch-on; later if the rig is not ready by then."""
    frames: Annotated[int, Meta(ge=1, le=1000)] = 5
    spacing: Annotated[int, Meta(ge=1, le=1000)] = 1
    exposure_ms: Annotated[float, Meta(gt=0, le=1000)] = 4.0
    scale: Annotated[float, Meta(ge=0.1, le=1)] = 1.0
    jpeg_quality: Annotated[int, Meta(ge=1, le=100)] = 90
    depth: bool = True
    """Whether each image has its true depth, or the session only the true times."""
    take: Take | None = None
    schema_version: int = SCHEMA_VERSION


def read_recipe(path: Path) -> Recipe:
    """Read a recipe, from its file or a rendered session's folder. Raises BadInputError, with the place."""
    file = path / RECIPE if path.is_dir() else path
    if not file.is_file():
        raise BadInputError(
            f"no recipe at {file}", hint="rendered sessions have one, such as sample_sessions/"
        )
    recipe = read_struct(file, Recipe, SCHEMA_VERSION)
    names = [camera.name for camera in recipe.cameras]
    for name in names:
        if names.count(name) > 1:
            raise BadInputError(f"{file} lists camera {name} twice")
    if recipe.take is not None:
        if [camera.name for camera in recipe.take.cameras] != names:
            raise BadInputError(
                f"{file} has a take of other cameras than it lists", hint="--retake takes it again"
            )
        known = range(len(recipe.take.burst.instants_ns))
        for frame in recipe.take.frames:
            if frame.camera not in names or frame.instant not in known:
                what = f"{frame.camera} at instant {frame.instant}"
                raise BadInputError(f"{file} has a frame in its take that is not of its burst: {what}")
    return recipe

"""Poses that a format gives to images: of a rig that stands still they are its cameras'."""

from collections.abc import Iterable, Sequence
from pathlib import PurePosixPath

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.camera_views import View

SAME_ROTATION, SAME_PLACE = 1e-5, 1e-5
"""Largest difference of two rotation matrices, and of two places as a share of the rig's extent."""


def camera_of(image: str, cameras: Sequence[str]) -> str:
    """The camera that an image's path is of: a part of it that is a camera's name, else its folder's name.

    Of an image in no folder it is its own name without the ending: one picture a camera. Raises
    BadInputError for a path without a name.
    """
    path = PurePosixPath(image.replace("\\", "/"))
    if not path.name:
        raise BadInputError(f"{image!r} is no path of an image")
    parts = path.with_suffix("").parts
    names = {name.casefold(): name for name in cameras}
    for part in reversed(parts):
        if part.casefold() in names:
            return names[part.casefold()]
    return parts[-2] if len(parts) > 1 else parts[-1]


def views_of_images(where: str, images: Iterable[tuple[str, View]], hint: str) -> dict[str, View]:
    """The one view of each camera, of images as (camera, view).

    Raises BadInputError, beginning with `where`, for a camera that moves between its images or changes.
    """
    views: dict[str, View] = {}
    rest: list[tuple[str, View]] = []
    for name, view in images:
        if views.setdefault(name, view) is not view:
            rest.append((name, view))
    extent = max((float(np.linalg.norm(view.translation)) for view in views.values()), default=0.0)
    for name, view in rest:
        if not same_view(views[name], view, extent):
            raise BadInputError(f"{where}: camera {name} is not in one place in all of its images", hint=hint)
    return views


def same_view(one: View, other: View, extent: float) -> bool:
    """Whether two views have one pose and one lens; `extent` is the rig's, in the unit of translations."""
    return (
        one.size == other.size
        and np.array_equal(one.matrix, other.matrix)
        and np.array_equal(one.distortion, other.distortion)
        and bool(np.abs(one.rotation - other.rotation).max() <= SAME_ROTATION)
        and bool(np.abs(one.translation - other.translation).max() <= SAME_PLACE * extent)
    )

"""People of a running rig's previews, for `reconstruct live`: see `simulshot.live` in docs/plugins.md."""

from collections.abc import Callable, Mapping

import numpy as np

from capture_app.session.format.live_pictures import (
    PEOPLE,
    WIDTHS_PX,
    InstantImages,
    LivePerson,
    PeoplePreview,
)
from capture_app.session.reading.decoding import encode_image
from reconstruction.common.geometry import Array, View
from reconstruction.methods.people.live_people import LivePeople
from reconstruction.methods.people.people_page import path_around
from reconstruction.methods.people.people_pictures import draw_joints

BONES = 1 / 80
"""Thickness of bones relative to a picture's height: a terminal has some 50 rows for it."""


def begin(
    views: Mapping[str, View], unit: str
) -> Callable[[InstantImages, Mapping[str, Array]], PeoplePreview]:
    """Return what locates people in the images (BGR) of an instant, by calibrated views and their unit.

    Raises:
        SimulshotError: the detector's runtime or its weights are not on this machine.
    """
    engine = LivePeople(views, WIDTHS_PX[PEOPLE])
    joints = engine.skeleton.joints

    def find(given: InstantImages, images: Mapping[str, Array]) -> PeoplePreview:
        found = engine.find(images, given.instant_ns / 1e9)
        people = []
        for one in found:
            rows = np.column_stack([one.positions, one.error])
            known = np.flatnonzero(np.isfinite(rows).all(axis=1)).tolist()
            people.append(LivePerson(one.number, {joints[k]: (*rows[k].tolist(),) for k in known}))
        jpeg = b""
        if given.camera in images:
            picture = images[given.camera]
            if (view := engine.views.get(given.camera)) is not None:
                now = [(one.number - 1, one.positions, one.error) for one in found]
                picture = draw_joints(picture, view, engine.skeleton, now, BONES)
            jpeg = encode_image(picture)
        points = [row[:3] for person in people for row in person.joints.values()]
        return PeoplePreview(
            given.instant_ns,
            given.camera,
            jpeg,
            people=(*people,),
            joints=joints,
            bones=engine.skeleton.bones,
            path=path_around(engine.views, np.array(points)) if points else {},
            unit=unit,
        )

    return find

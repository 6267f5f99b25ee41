"""People in a page to walk round: bones and joints of each time, each joint as large as its error."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.walk import SKELETONS
from reconstruction.common.camera_paths import frame_of
from reconstruction.common.geometry import Array, View
from reconstruction.methods.people.people_run import UNSURE, PeopleInTime
from reconstruction.pages.walk_page import Drawing, path_of, write_walk_page

HELD = 64
"""Number of times that the page keeps in the GPU's memory."""
MAX_TIMES = 2000
"""Most times of a page: of a longer film, evenly spread ones."""
MIN_HALF = (0.8, 0.4)
"""Angles (radians) to the side and up that are half an extent at least: bones are seen from all around."""
MAX_RISE = 1.4
"""Angle (radians) up or down beyond which the eye would be above its own head."""
ALL_ROUND = 1e6
LEGEND = (
    f"A ball is a joint's error; a ring is an unsure joint, whose error is over {100 * UNSURE:.0f} % of the"
    " person's size."
)


def write_people_page(
    page: Path, name: str, people: PeopleInTime, views: Mapping[str, View], still: Array
) -> None:
    """Write the page as a file; `still` is the picture for browsers without 3D."""
    shown = np.unique(
        np.linspace(0, len(people.times_s) - 1, min(len(people.times_s), MAX_TIMES)).astype(int)
    )
    points = np.concatenate([person.positions[np.isfinite(person.error)] for person in people.people])
    instants = [
        {
            "instant": time,
            "people": [
                [
                    None if np.isnan(error) else [*np.round(place, 5).tolist(), round(error, 5)]
                    for place, error in zip(person.positions[time], person.error[time].tolist(), strict=True)
                ]
                for person in people.people
            ],
        }
        for time in shown.tolist()
    ]
    step_s = float(np.diff(people.times_s[shown]).mean()) if len(shown) > 1 else 1.0
    write_walk_page(
        page,
        name,
        path=path_around(views, points),
        views=views,
        still=still,
        period_ns=round(step_s * 1e9),
        drawing=Drawing(
            SKELETONS,
            instants,
            {"held": HELD, "bones": people.skeleton.bones, "whole": True},
            LEGEND,
        ),
    )


def path_around(views: Mapping[str, View], points: Array) -> dict[str, Any]:
    """Return the places from which a page looks at points (n, 3), from all around them; see `path_of`."""
    frame = frame_of(views, np.median(points, axis=0))
    across, down = np.maximum(frame.half, MIN_HALF).tolist()
    distances = np.linalg.norm(points - np.array([view.centre for view in views.values()])[:, None], axis=2)
    return path_of(
        frame._replace(half=(across, down)),
        (float(distances.min()), float(distances.max())),
        views,
        (ALL_ROUND, (MAX_RISE - abs(frame.middle[1])) / down),
    )

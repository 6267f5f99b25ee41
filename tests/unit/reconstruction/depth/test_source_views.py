"""Which cameras see the same, and what is said of rigs of which none do."""

from dataclasses import replace

import cv2
import numpy as np

from reconstruction.common.geometry import View
from reconstruction.depth.view_choice import (
    choose_reference_view,
    grid_points,
    refuse_views,
    score_points,
    smallest_group,
)
from tests.unit.reconstruction.depth.small_views import (
    HEIGHT,
    MATRIX,
    PLACES,
    WIDTH,
    choose_by_depth,
    view_at,
)


def test_sources_see_the_same_from_elsewhere() -> None:
    views = {"a": view_at(0), "b": view_at(0.2), "far": view_at(30.0), "same": view_at(1e-4)}
    chosen = choose_by_depth(views)
    assert chosen["a"] == ("b",)
    assert chosen["far"] == ()
    assert score_points(views["a"], views["same"], grid_points(views["a"], 2.0)) < 0.01


def test_the_middle_camera_is_the_reference() -> None:
    views = {name: view_at(*at) for name, at in PLACES.items()}
    points = {name: grid_points(view, 2.0) for name, view in views.items()}
    assert choose_reference_view(views, points) == "middle"
    # Wherever the rig's origin is.
    views = {name: view_at(x + 5, y - 3) for name, (x, y) in PLACES.items()}
    points = {name: grid_points(view, 2.0) for name, view in views.items()}
    assert choose_reference_view(views, points) == "middle"


def test_a_refusal_says_what_is_wrong_with_the_rig() -> None:
    def toward_origin(angle_deg: float, distance: float = 2.0) -> View:
        """A camera that looks at the origin from this angle."""
        turn, _ = cv2.Rodrigues(np.array([0.0, np.radians(angle_deg), 0.0]))
        return View(WIDTH, HEIGHT, MATRIX, np.zeros(5), turn, np.array([0.0, 0.0, distance]))

    def refusal(*views: View) -> str:
        named = {f"cam{number}": view for number, view in enumerate(views)}
        return refuse_views(named, {name: grid_points(view, 2.0) for name, view in named.items()}).what

    def refusal_unseen(*views: View) -> str:
        return refuse_views({f"cam{number}": view for number, view in enumerate(views)}).what

    assert "too close together" in refusal(toward_origin(0), toward_origin(0.2))
    assert "0.2 degrees apart" in refusal(toward_origin(0), toward_origin(0.2))
    assert "too far apart" in refusal(toward_origin(0), toward_origin(70))
    assert "too far apart" in refusal_unseen(toward_origin(0), toward_origin(180))
    back = replace(view_at(0.2), rotation=np.diag([-1.0, 1.0, -1.0]))
    assert "no camera sees what another sees" in refusal_unseen(view_at(0), back)
    assert "one place" in refusal_unseen(view_at(0), view_at(0))


def test_opposite_pairs_are_groups_of_their_own() -> None:
    assert smallest_group({"a": ("b",), "b": ("a",), "c": ("d",), "d": ("c",), "alone": ()}) == 2
    assert smallest_group({"a": ("b",), "b": ("c",), "c": ("b",)}) == 3

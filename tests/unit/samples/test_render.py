"""Recipes without a take: the engine takes the burst, and the recipe that comes out gives the same bytes."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks.samples.recipe import CameraRecipe, Recipe, Trigger
from benchmarks.samples.render import render
from capture_app.common.errors import BadInputError
from capture_app.session.writing.session_writer import SessionWriter


def recipe_of(**changes: Any) -> Recipe:
    """Two cameras that see the test card, which needs no renderer."""
    cameras = (CameraRecipe(name="cam00"), CameraRecipe(name="cam01", profile="phone-b"))
    values = {"name": "card", "scene": "bars", "cameras": cameras, "frames": 3, "scale": 0.2, "at_s": 0.0}
    return Recipe(**{"created": "2026-01-01T00:00:00.000Z", **values, **changes})


def test_naive_cameras_know_no_times(tmp_path: Path) -> None:
    manifest = render(recipe_of(trigger=Trigger.NAIVE), tmp_path)[0].manifest
    assert all(camera.clock is None and camera.phase is None for camera in manifest.cameras)
    assert all(image.uncertainty_ns is None and image.exposure_start_ns is None for image in manifest.images)


def test_a_captured_session_is_never_replaced(tmp_path: Path) -> None:
    SessionWriter.create(tmp_path, "card").abort()
    with pytest.raises(BadInputError, match="not a rendered session"):
        render(recipe_of(), tmp_path, replace=True)
    assert (tmp_path / "card" / "journal.ndjson").exists()

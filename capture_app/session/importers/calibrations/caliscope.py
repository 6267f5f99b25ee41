"""Caliscope's `camera_array.toml` (and Anipose's, which has the same tables): lengths in metres."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.camera_views import Array, View, Views, from_rodrigues


def read_caliscope(path: Path) -> Views:
    """Read the cameras of a Caliscope or Anipose TOML; a rotation is a matrix or a Rodrigues vector.

    Raises BadInputError, with the camera, for what is broken or not yet calibrated.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadInputError(f"cannot read the calibration {path}: {error}") from error
    inner = content.get("cameras")
    tables = inner if isinstance(inner, dict) else content
    found = {key: table for key, table in tables.items() if isinstance(table, dict) and "matrix" in table}
    if not found:
        raise BadInputError(
            f"{path} has no camera with a matrix", hint="is it Caliscope's camera_array.toml?"
        )
    views = {}
    for key, table in found.items():
        label = str(table.get("name", table.get("cam_id", table.get("port", key))))
        views[label] = _view(f"{path}: camera {label}", table)
    return Views(views, path.name)


def _view(where: str, table: dict[str, Any]) -> View:
    size = _numbers(where, table, "size", 2)
    rotation = _numbers(where, table, "rotation", 3, 9)
    return View(
        matrix=_numbers(where, table, "matrix", 9).reshape(3, 3),
        distortion=_numbers(where, table, "distortions", 4, 5, 8),
        rotation=rotation.reshape(3, 3) if rotation.size == 9 else from_rodrigues(rotation),
        translation=_numbers(where, table, "translation", 3),
        size=(int(size[0]), int(size[1])),
    )


def _numbers(where: str, table: dict[str, Any], key: str, *counts: int) -> Array:
    try:
        values = np.asarray(table[key], np.float64).ravel()
    except KeyError:
        raise BadInputError(f"{where} has no {key}", hint="is the calibration complete?") from None
    except (TypeError, ValueError):
        raise BadInputError(f"{where}: {key} is not made of numbers") from None
    if values.size not in counts:
        raise BadInputError(f"{where}: {key} has {values.size} numbers, not {' or '.join(map(str, counts))}")
    return values

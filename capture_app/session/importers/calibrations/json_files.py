"""Calibrations in JSON: our own, nerfstudio's and COLMAP's rigs, told apart by what is in them."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from capture_app.errors import BadInputError
from capture_app.session.importers.calibrations.camera_views import Views


def read_json(path: Path, cameras: Sequence[str]) -> Views:
    """Read a calibration.json, transforms.json or rig_config.json. Raises BadInputError for anything else."""
    try:
        content = msgspec.json.decode(path.read_bytes())
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path} is not JSON: {error}") from error
    if isinstance(content, dict) and isinstance(content.get("frames"), list):
        from capture_app.session.importers.calibrations.nerfstudio import views_of_transforms

        return views_of_transforms(path, content, cameras)
    rigs = content if isinstance(content, list) else []
    if rigs and all(isinstance(rig, dict) and isinstance(rig.get("cameras"), list) for rig in rigs):
        from capture_app.session.importers.calibrations.colmap import views_of_rig_config

        return views_of_rig_config(path, rigs)
    if isinstance(content, dict) and isinstance(content.get("cameras"), dict):
        from capture_app.session.importers.calibrations.own_file import read_own

        return read_own(path)
    hint = "known: simulshot's calibration.json, nerfstudio's transforms.json, COLMAP's rig_config.json"
    raise BadInputError(f"{path} is not a calibration", hint=hint)

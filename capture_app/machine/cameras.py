"""Cameras of this machine, with or without a running rig: list them and query their modes."""

import logging
from collections.abc import Mapping

from capture_app.cameras import specs
from capture_app.cameras.base import CameraDriver
from capture_app.common.camera_facts import SIMULATED, CameraListing
from capture_app.common.text import first_line

common_options = specs.common_options
_log = logging.getLogger(__name__)


def kinds_of_cameras() -> Mapping[str, CameraDriver]:
    """Return the driver of each kind, which describes its specs, its options and its requirements."""
    return specs.load_drivers()


def list_cameras(*, simulated: bool = True) -> list[CameraListing]:
    """Return the cameras of this machine, then the simulated models; opens devices, which may take a second.

    A driver that fails is named on stderr and left out.
    """
    cameras: list[CameraListing] = []
    for kind, driver in specs.load_drivers().items():
        try:
            cameras += driver.list_cameras() if simulated or kind != SIMULATED else ()
        except Exception as error:  # noqa: BLE001 - a plugin raises what it likes, and the others still list
            _log.warning("the driver of %s cameras cannot list them: %s", kind, first_line(error))
    return cameras


def modes_of(spec: str) -> str:
    """Return the modes of a spec's camera, in its driver's words; empty if it is not listed.

    Raises BadInputError for a spec that cannot be read.
    """
    parsed = specs.parse_spec(spec)
    listed = specs.load_driver(parsed.kind).list_cameras()
    return next((camera.detail for camera in listed if camera.spec == f"{parsed.kind}:{parsed.device}"), "")
